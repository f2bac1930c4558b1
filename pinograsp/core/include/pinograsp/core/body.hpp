// Shapes of many convex pieces, as the triangles of a surface, in a tree of boxes.
#pragma once

#include <algorithm>
#include <utility>

#include "overlap.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// Along the axes of a shape's own frame.
struct Bounds {
    Triple low{}, high{}, middle{};
    double radius = 0.0;  // of the ball around them

    Bounds() = default;
    explicit Bounds(const Solid& solid) {
        for (int i = 0; i < 3; ++i) {
            Triple axis{};
            axis[i] = 1.0;
            high[i] = solid.farthest(axis)[i];
            low[i] = solid.farthest(-1.0 * axis)[i];
        }
        enclose();
    }
    void add(const Bounds& other) {
        for (int i = 0; i < 3; ++i) low[i] = std::min(low[i], other.low[i]), high[i] = std::max(high[i], other.high[i]);
        enclose();
    }
    void enclose() { middle = 0.5 * (low + high), radius = 0.5 * length(high - low); }
    // Distance of a point, squared.
    double squared(const Triple& point) const {
        double found = 0.0;
        for (int i = 0; i < 3; ++i) {
            const double off = std::max(std::max(low[i] - point[i], point[i] - high[i]), 0.0);
            found += off * off;
        }
        return found;
    }
    // How far it reaches along a direction.
    double reach(const Triple& along) const {
        double found = 0.0;
        for (int i = 0; i < 3; ++i) found += along[i] * (along[i] > 0.0 ? high[i] : low[i]);
        return found;
    }
};

// How far two boxes are apart at least, as far as the balls around them tell, more than `enough` not exactly; `there`:
// of the second, seen from the first.
inline double room_between(const Bounds& one, const Bounds& other, const Frame& there, double enough) {
    const double first = std::sqrt(one.squared(there.act(other.middle))) - other.radius;
    if (first > enough) return first;
    return std::max(first, std::sqrt(other.squared(there.act_back(one.middle))) - one.radius);
}

class Body {
public:
    struct Node {
        Bounds bounds;
        int left, right;  // nodes; of a leaf the first is -1, and the other its piece
    };

    Body() = default;
    explicit Body(Solid solid) : Body(std::vector<Solid>{std::move(solid)}) {}
    // Those that have points.
    explicit Body(std::vector<Solid> pieces) : pieces_(std::move(pieces)) {
        pieces_.erase(std::remove_if(pieces_.begin(), pieces_.end(), [](const Solid& one) { return one.empty(); }),
                      pieces_.end());
        std::vector<std::pair<int, Bounds>> all;
        for (const Solid& piece : pieces_) all.push_back({static_cast<int>(all.size()), Bounds(piece)});
        nodes_.reserve(2 * all.size());
        if (!all.empty()) split(all, 0, all.size());
    }

    bool empty() const { return pieces_.empty(); }
    bool whole() const { return pieces_.size() == 1; }
    const Node& node(int i) const { return nodes_[i]; }
    const Bounds& bounds() const { return nodes_[0].bounds; }
    const Solid& piece(int i) const { return pieces_[i]; }

private:
    int split(std::vector<std::pair<int, Bounds>>& all, std::size_t start, std::size_t stop) {
        Bounds bounds = all[start].second;
        for (std::size_t i = start + 1; i < stop; ++i) bounds.add(all[i].second);
        const int own = static_cast<int>(nodes_.size());
        nodes_.push_back({bounds, -1, all[start].first});
        if (stop - start == 1) return own;
        const Triple half = bounds.high - bounds.middle;
        const std::size_t axis = std::max_element(half.begin(), half.end()) - half.begin(), middle = (start + stop) / 2;
        std::nth_element(all.begin() + start, all.begin() + middle, all.begin() + stop,
                         [axis](const auto& a, const auto& b) {
                             // Numbers that are none have no order.
                             const double x = a.second.middle[axis], y = b.second.middle[axis];
                             const bool left = std::isfinite(x), right = std::isfinite(y);
                             if (left && right && x != y) return x < y;
                             return left != right ? left : a.first < b.first;
                         });
        const int left = split(all, start, middle), right = split(all, middle, stop);
        nodes_[own].left = left, nodes_[own].right = right;
        return own;
    }

    std::vector<Solid> pieces_;
    std::vector<Node> nodes_;
};

// A unit vector from the middle of one body to that of another; `there`: of the second, seen from the first.
inline Triple towards(const Body& one, const Body& other, const Frame& there) {
    return unit_along(there.act(other.bounds().middle) - one.bounds().middle);
}

// Which pieces of two bodies were nearest, and where; none: -1.
struct NearestPieces {
    int one = -1, other = -1;
    Footing footing{};
};

// The gap between two bodies: of the pieces that are nearest, or overlap most.
class Nearest {
public:
    // `there`: of the second body, seen from the first, as what is found. `normal`: about where to from the first. Of
    // what is wider than `beyond` no more is told, and where `deep` is false, of overlaps no more than that. `before`:
    // where the same two were nearest, which is looked at first, and kept.
    Nearest(const Body& one, const Body& other, const Frame& there, const Triple& normal, double beyond,
            bool deep = true, NearestPieces* before = nullptr)
        : one_(one), other_(other), there_(there), deep_(deep) {
        gap.normal = normal;
        widest_ = beyond;
        if (one.empty() || other.empty()) return;
        if (one.whole() && other.whole()) {
            gap = measure({one.piece(0), other.piece(0), there}, normal, beyond, deep,
                          before ? &before->footing : nullptr);
            return;
        }
        before_ = before;
        middle_ = there.act_back(one.bounds().middle);
        Separation known{std::numeric_limits<double>::infinity(), normal};
        if (before && before->one >= 0)
            known = measure({one.piece(before->one), other.piece(before->other), there}, normal, beyond, deep,
                            &before->footing);
        if (known.distance <= beyond)
            take(known);
        else
            face();
        look(0, 0);
    }

    Separation gap{std::numeric_limits<double>::infinity(), {}};

private:
    // The direction known so far: as the other sees it, and how far what is of one piece reaches along it.
    void face() {
        seen_ = there_.turn_back(-1.0 * gap.normal);
        off_ = dot(gap.normal, there_.t);
        if (one_.whole()) reach_ = dot(gap.normal, one_.piece(0).farthest(gap.normal));
        if (other_.whole()) other_reach_ = dot(seen_, other_.piece(0).farthest(seen_));
    }

    // How far two nodes are apart at least: by the balls around their boxes, and across the direction known so far.
    double room(const Bounds& a, const Bounds& b) const {
        const double parted =
            off_ - (other_.whole() ? other_reach_ : b.reach(seen_)) - (one_.whole() ? reach_ : a.reach(gap.normal));
        if (parted >= widest_) return parted;
        if (!one_.whole()) return std::max(parted, room_between(a, b, there_, widest_));
        const double room = std::max(parted, std::sqrt(b.squared(middle_)) - a.radius);
        return room >= widest_ ? room : std::max(room, std::sqrt(a.squared(there_.act(b.middle))) - b.radius);
    }

    void look(int i, int j) {
        const Body::Node &a = one_.node(i), &b = other_.node(j);
        if (a.left < 0 && b.left < 0) {
            const Solid& piece = other_.piece(b.right);
            if (one_.whole() && off_ - reach_ - dot(seen_, piece.farthest(seen_)) > widest_) return;
            Footing footing;
            const Separation found =
                measure({one_.piece(a.right), piece, there_}, gap.normal, widest_, deep_, before_ ? &footing : nullptr);
            if (!(found.distance <= widest_)) return;
            take(found);
            if (before_) *before_ = {a.right, b.right, footing};
            return;
        }
        const bool first = b.left < 0 || (a.left >= 0 && a.bounds.radius > b.bounds.radius);
        const int ways[2][2] = {{first ? a.left : i, first ? j : b.left}, {first ? a.right : i, first ? j : b.right}};
        double rooms[2];
        for (int k = 0; k < 2; ++k) rooms[k] = room(one_.node(ways[k][0]).bounds, other_.node(ways[k][1]).bounds);
        const int nearer = rooms[1] < rooms[0];
        for (int k : {nearer, 1 - nearer})
            if (rooms[k] <= widest_) look(ways[k][0], ways[k][1]);
    }

    void take(const Separation& found) {
        gap = found;
        face();
        widest_ = gap.distance > 0.0 ? gap.distance - alike : -std::numeric_limits<double>::infinity();
    }

    static constexpr double alike = 1e-12;  // [m] of neighbours, which share what is nearest, one is enough

    const Body &one_, &other_;
    Frame there_;
    Triple seen_{}, middle_{};
    double widest_, off_ = 0.0, reach_ = 0.0, other_reach_ = 0.0;
    bool deep_;
    NearestPieces* before_ = nullptr;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
