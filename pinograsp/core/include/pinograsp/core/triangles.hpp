// Which triangles of a surface are nearest to points.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "body.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// Triangles that may be nearest to points, one after the other: which point, and which triangle.
struct NearTriangles {
    std::vector<std::int64_t> point, triangle;
};

// With memory of its own.
class Triangles {
public:
    // Of corners, three each.
    explicit Triangles(std::vector<Triple> corners) : corners_(std::move(corners)), tree_(pieces()) {}

    const Body& tree() const { return tree_; }

    // Adds those that are no more than `slack` [m] farther from a point than the nearest one.
    void find_near(const Triple& point, std::int64_t which, double slack, NearTriangles& found) {
        slack_ = slack, least_ = std::numeric_limits<double>::infinity();
        seen_.clear();
        if (!tree_.empty()) look(point, 0);
        const double reach = widened();
        for (const auto& [squared, triangle] : seen_)
            if (squared <= reach) found.point.push_back(which), found.triangle.push_back(triangle);
    }

private:
    std::vector<Solid> pieces() const {
        std::vector<Solid> found;
        for (std::size_t i = 0; i + 2 < corners_.size(); i += 3)
            found.push_back(Solid({corners_[i], corners_[i + 1], corners_[i + 2]}, {}));
        return found;
    }

    double widened() const {
        const double reach = std::sqrt(least_) + slack_;
        return reach * reach;
    }

    void look(const Triple& point, int i) {
        const Body::Node& node = tree_.node(i);
        if (node.left < 0) {
            const double squared = squared_to(point, node.right);
            least_ = std::min(least_, squared);
            if (squared <= widened()) seen_.push_back({squared, node.right});
            return;
        }
        const double left = tree_.node(node.left).bounds.squared(point),
                     right = tree_.node(node.right).bounds.squared(point);
        const bool other = right < left;
        if ((other ? right : left) <= widened()) look(point, other ? node.right : node.left);
        if ((other ? left : right) <= widened()) look(point, other ? node.left : node.right);
    }

    // Squared distance of a point from a triangle: from its edges, or its plane where that is nearer and the foot is
    // within, which in a needle rounding must not decide.
    double squared_to(const Triple& point, int triangle) const {
        const Triple* corner = corners_.data() + 3 * static_cast<std::size_t>(triangle);
        double least = std::numeric_limits<double>::infinity();
        for (int i = 0; i < 3; ++i) {
            const Triple side = corner[(i + 1) % 3] - corner[i], off = point - corner[i];
            const double square = dot(side, side);
            const double along = square > 0.0 ? std::clamp(dot(off, side) / square, 0.0, 1.0) : 0.0;
            const Triple left = off - along * side;
            least = std::min(least, dot(left, left));
        }
        const Triple ab = corner[1] - corner[0], ac = corner[2] - corner[0], ap = point - corner[0];
        const Triple normal = cross(ab, ac);
        const double square = dot(normal, normal);
        if (!(square > 0.0)) return least;
        const double beta = dot(cross(ap, ac), normal), gamma = dot(cross(ab, ap), normal);
        if (!(beta > 0.0 && gamma > 0.0 && beta + gamma < square)) return least;
        const double height = dot(ap, normal);
        return std::min(least, height * height / square);
    }

    std::vector<Triple> corners_;
    Body tree_;
    double slack_ = 0.0, least_ = 0.0;
    std::vector<std::pair<double, int>> seen_;
};

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
