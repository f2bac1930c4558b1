// Which triangles of a surface are nearest to points.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "body.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// The point of a triangle that is nearest to another one.
struct FootPoint {
    Triple at{};
    double squared = std::numeric_limits<double>::infinity();  // of the distance
    int feature = 0;                                           // 0: of the face; 1 to 3 of a side, 4 to 6 of a corner
};

// The triangle nearest to a point, the first of those that are as near but for rounding; and whether another one is as
// near on the opposite side.
struct NearestTriangle {
    std::int64_t triangle = -1;
    FootPoint foot;
    bool opposite = false;
};

// With memory of its own.
class Triangles {
public:
    // Of corners, three each.
    explicit Triangles(std::vector<Triple> corners) : corners_(std::move(corners)), tree_(pieces()) {}

    const Body& tree() const { return tree_; }

    // `alike` [m]: distances that differ by less are equal.
    NearestTriangle find_nearest(const Triple& point, double alike) {
        alike_ = alike, least_ = std::numeric_limits<double>::infinity();
        seen_.clear();
        if (!tree_.empty()) look(point, 0);
        NearestTriangle found;
        const double least = std::sqrt(least_) + rounding;
        for (const auto& [foot, triangle] : seen_)
            if (foot.squared <= least * least && (found.triangle < 0 || triangle < found.triangle))
                found.foot = foot, found.triangle = triangle;
        const Triple off = found.foot.at - point;
        const double reach = widened();
        for (const auto& [foot, triangle] : seen_)
            found.opposite |= foot.squared <= reach && foot.squared > alike * alike &&
                              dot(foot.at - point, off) < -opposed * std::sqrt(foot.squared * found.foot.squared);
        return found;
    }

private:
    std::vector<Solid> pieces() const {
        std::vector<Solid> found;
        for (std::size_t i = 0; i + 2 < corners_.size(); i += 3)
            found.push_back(Solid({corners_[i], corners_[i + 1], corners_[i + 2]}, {}));
        return found;
    }

    // Two directions at more than 135 degrees from each other; at less they are of neighbours across a side.
    static constexpr double opposed = 0.70710678118654752;
    static constexpr double rounding = 1e-12;  // [m]

    double widened() const {
        const double reach = std::sqrt(least_) + alike_;
        return reach * reach;
    }

    void look(const Triple& point, int i) {
        const Body::Node& node = tree_.node(i);
        if (node.left < 0) {
            const FootPoint foot = foot_on(point, node.right);
            least_ = std::min(least_, foot.squared);
            if (foot.squared <= widened()) seen_.push_back({foot, node.right});
            return;
        }
        const double left = tree_.node(node.left).bounds.squared(point),
                     right = tree_.node(node.right).bounds.squared(point);
        const bool other = right < left;
        if ((other ? right : left) <= widened()) look(point, other ? node.right : node.left);
        if ((other ? left : right) <= widened()) look(point, other ? node.left : node.right);
    }

    // Of its sides, or its plane where that is no farther and the foot is within, which in a needle rounding must not
    // decide.
    FootPoint foot_on(const Triple& point, int triangle) const {
        const Triple* corner = corners_.data() + 3 * static_cast<std::size_t>(triangle);
        FootPoint found;
        const auto take = [&](const Triple& at, int feature) {
            const Triple off = at - point;
            if (const double squared = dot(off, off); squared < found.squared) found = {at, squared, feature};
        };
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3;
            const Triple side = corner[j] - corner[i], off = point - corner[i];
            const double square = dot(side, side);
            const double along = square > 0.0 ? std::clamp(dot(off, side) / square, 0.0, 1.0) : 0.0;
            // From the end at 1, the end itself, which the sum misses by rounding.
            take(along == 1.0 ? corner[j] : corner[i] + along * side, along == 0.0   ? 4 + i
                                                                      : along == 1.0 ? 4 + j
                                                                                     : 1 + i);
        }
        const Triple ab = corner[1] - corner[0], ac = corner[2] - corner[0], ap = point - corner[0];
        const Triple normal = cross(ab, ac);
        const double square = dot(normal, normal);
        if (!(square > 0.0)) return found;
        const double beta = dot(cross(ap, ac), normal), gamma = dot(cross(ab, ap), normal);
        if (!(beta > 0.0 && gamma > 0.0 && beta + gamma < square)) return found;
        const Triple foot = point - (dot(ap, normal) / square) * normal, off = foot - point;
        if (const double squared = dot(off, off); squared <= found.squared) found = {foot, squared, 0};
        return found;
    }

    std::vector<Triple> corners_;
    Body tree_;
    double alike_ = 0.0, least_ = 0.0;
    std::vector<std::pair<FootPoint, int>> seen_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
