// How far two convex solids overlap: the polytope that grows within their difference (EPA), van den Bergen, 2001.
#pragma once

#include <array>

#include "convex.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// The nearest points of two solids that are apart, or the shortest way out of one another.
struct Separation {
    double distance = 0.0;   // [m], negative where they overlap; where it is beyond what was asked, no more than that
    Triple normal{};         // from the first to the second
    Triple mine{}, other{};  // nearest points, where the cores are apart
    double apart = 0.0;      // of the cores [m], 0 where they overlap
};

// Within the difference of two solids, around the origin.
class Polytope {
public:
    // A tetrahedron with the corners of a simplex that has the origin.
    Polytope(const Couple& couple, const Simplex& simplex) : couple_(couple) {
        for (int i = 0; i < simplex.count(); ++i) corners_[count_++] = simplex.corner(i).point;
        if (count_ == 0) corners_[count_++] = couple_.farthest({1.0, 0.0, 0.0}).point;
        while (count_ < 4)
            if (!add_corner()) return;
        const Triple a = corners_[1] - corners_[0], b = corners_[2] - corners_[0], c = corners_[3] - corners_[0];
        if (dot(a, cross(b, c)) > 0.0) std::swap(corners_[1], corners_[2]);
        add_face(0, 1, 2), add_face(0, 3, 1), add_face(0, 2, 3), add_face(1, 3, 2);
    }

    // Depth and direction of the shortest way out: of what is flat, across it.
    Separation grow() {
        constexpr double near = 1e-6, off = 1e-9;
        double best = std::numeric_limits<double>::infinity();
        Triple normal = flat_;
        if (count_ < 4 || faces_ < 4) best = 0.0;
        while (faces_ > 0 && count_ < most_corners) {
            int least = 0;
            for (int i = 1; i < faces_; ++i)
                if (face_[i].distance < face_[least].distance) least = i;
            const Face face = face_[least];
            if (face.distance >= best) break;
            const Triple w = couple_.farthest(face.normal).point;
            const double depth = dot(w, face.normal);
            if (depth < best) best = depth, normal = face.normal;
            if (best - face.distance <= near * best + off || !take(w, least)) break;
        }
        return {-std::max(best, 0.0) - couple_.round(), normal};
    }

private:
    static constexpr int most_corners = 128, most_faces = 2 * most_corners;
    struct Face {
        std::array<int, 3> at;
        Triple normal;  // outwards
        double distance;
    };

    // Another corner off those there are; false where there is none, the difference being flat.
    bool add_corner() {
        constexpr double apart = 1e-9;
        Triple ways[3];
        int count = 1;
        if (count_ == 1) {
            ways[0] = {1.0, 0.0, 0.0}, ways[1] = {0.0, 1.0, 0.0}, ways[2] = {0.0, 0.0, 1.0};
            count = 3;
        } else {
            const Triple a = corners_[1] - corners_[0];
            const double size = length(a);
            if (!(size > 0.0)) return false;
            const Triple unit = (1.0 / size) * a;
            ways[0] = across(unit);
            if (count_ == 2) {
                ways[1] = cross(unit, ways[0]);
                count = 2;
            } else {
                const Triple normal = cross(a, corners_[2] - corners_[0]);
                const double area = length(normal);
                if (!(area > 0.0)) return false;
                ways[0] = (1.0 / area) * normal;
            }
        }
        for (int i = 0; i < count; ++i)
            for (double sign : {1.0, -1.0}) {
                const Triple way = sign * ways[i], w = couple_.farthest(way).point;
                // Of two ways across a line one is across what is flat as well.
                if (!(dot(w - corners_[0], way) > apart)) {
                    flat_ = way;
                    continue;
                }
                corners_[count_++] = w;
                return true;
            }
        return false;
    }

    bool add_face(int a, int b, int c) {
        if (faces_ == most_faces) return false;
        const Triple normal = cross(corners_[b] - corners_[a], corners_[c] - corners_[a]);
        const double size = length(normal);
        if (!(size > 0.0)) return false;
        Face& face = face_[faces_++];
        face = {{a, b, c}, (1.0 / size) * normal, 0.0};
        face.distance = dot(face.normal, corners_[a]);
        return true;
    }

    // Takes a point in that lies beyond a face; false where it is too near to make new faces.
    bool take(const Triple& w, int beyond) {
        constexpr double level = 1e-11;  // [m] what is in one plane with the point goes with what it sees
        rim_ = 0;
        remove(beyond);
        for (bool more = true; more;) {
            more = false;
            for (int i = faces_; i-- > 0;)
                if (dot(face_[i].normal, w) > face_[i].distance - level && borders(face_[i])) remove(i), more = true;
        }
        const int own = count_;
        corners_[count_++] = w;
        for (int e = 0; e < rim_; ++e)
            if (!add_face(edges_[e][0], edges_[e][1], own)) return false;
        return true;
    }

    // Where an edge of a face is on the rim of those that were removed, the other way round; -1: nowhere.
    int find_edge(const Face& face, int e) const {
        for (int i = 0; i < rim_; ++i)
            if (edges_[i][0] == face.at[(e + 1) % 3] && edges_[i][1] == face.at[e]) return i;
        return -1;
    }
    bool borders(const Face& face) const {
        return find_edge(face, 0) >= 0 || find_edge(face, 1) >= 0 || find_edge(face, 2) >= 0;
    }
    void remove(int which) {
        const Face face = face_[which];
        face_[which] = face_[--faces_];
        for (int e = 0; e < 3; ++e)
            if (const int i = find_edge(face, e); i >= 0)
                edges_[i] = edges_[--rim_];
            else
                edges_[rim_++] = {face.at[e], face.at[(e + 1) % 3]};
    }

    const Couple& couple_;
    Triple flat_{1.0, 0.0, 0.0};
    std::array<Triple, most_corners> corners_;
    std::array<Face, most_faces> face_;
    std::array<std::array<int, 2>, 3 * most_faces> edges_;  // of the hole that faces left
    int count_ = 0, faces_ = 0, rim_ = 0;
};

// The gap between two solids, found along a unit vector at first, or where they were nearest before, as seen from the
// first; what is wider than `beyond` is only told to be so, and where `deep` is false, of overlaps no more than that.
inline Separation measure(const Couple& couple, const Triple& along, double beyond, bool deep = true,
                          Footing* footing = nullptr) {
    constexpr double touching = 1e-10;
    const Parting plane = part(couple, along, closely, beyond, footing);
    if (plane.distance > beyond) return {plane.distance, plane.normal};
    if (!(plane.size > touching)) return deep ? Polytope(couple, plane.simplex).grow() : Separation{0.0, plane.normal};
    // The direction between points that are nearly nearest has half of their digits, that of the plane all.
    const Triple &normal = plane.normal, &mine = plane.nearest.own;
    return {plane.distance, normal, mine + couple.one.round() * normal,
            mine - plane.nearest.point - couple.other.round() * normal, plane.size};
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
