// The balance from contact points and frames.
#pragma once

#include "dual.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// The columns of a contact in its lane: from its point about the centre of mass (3), its frame (3, 3), friction `mu`
// and `torsion` [m] over the safety factor; moments over `arm`, infinite where they do not count.
template <class K>
PINOGRASP_INLINE void set_columns(Block<K>& block, int lane, const double* point, const double* rotation, double mu,
                                  double torsion, double arm) {
    const double x = point[0] / arm, y = point[1] / arm, z = point[2] / arm;
    for (int c = 0; c < 3; ++c) {
        const int j = c == 2 ? K::E : c;
        const double size = c == 2 ? 1.0 : mu;
        const double u = size * rotation[c], v = size * rotation[3 + c], w = size * rotation[6 + c];
        in_lane(block.a[j][0], lane) = u;
        in_lane(block.a[j][1], lane) = v;
        in_lane(block.a[j][2], lane) = w;
        in_lane(block.a[j][3], lane) = y * w - z * v;
        in_lane(block.a[j][4], lane) = z * u - x * w;
        in_lane(block.a[j][5], lane) = x * v - y * u;
    }
    if constexpr (K::D == 4)
        for (int r = 0; r < K::M; ++r)
            in_lane(block.a[2][r], lane) = r < 3 ? 0.0 : rotation[3 * (r - 3) + 2] * torsion / arm;
}

// The unit of component j of a contact: [N], [N m] for torsion, per newton at the friction limit.
template <class K>
PINOGRASP_INLINE double unit_of(int j, double mu, double torsion) {
    return j == K::E ? 1.0 : j == 2 ? torsion : mu;
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
