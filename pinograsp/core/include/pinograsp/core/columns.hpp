// The balance from contact points and frames.
#pragma once

#include "dual.hpp"

namespace pinograsp::core {
inline namespace PINOGRASP_CORE_LEVEL {

// The wrench (6) of a force (u, v, w) at a point, moments over `arm`.
PINOGRASP_INLINE void wrench_of(const double* point, double u, double v, double w, double arm, double* out) {
    const double x = point[0] / arm, y = point[1] / arm, z = point[2] / arm;
    const double found[6] = {u, v, w, y * w - z * v, z * u - x * w, x * v - y * u};
    for (int r = 0; r < 6; ++r) out[r] = found[r];
}

// The columns of a contact in its lane: from its point about the centre of mass (3), its frame (3, 3), friction `mu`
// and `torsion` [m] over the safety factor; moments over `arm`, infinite where they do not count.
template <class K>
PINOGRASP_INLINE void set_columns(Block<K>& block, int lane, const double* point, const double* rotation, double mu,
                                  double torsion, double arm) {
    for (int c = 0; c < 3; ++c) {
        const double size = c == 2 ? 1.0 : mu;
        double own[6];
        wrench_of(point, size * rotation[c], size * rotation[3 + c], size * rotation[6 + c], arm, own);
        for (int r = 0; r < K::M; ++r) in_lane(block.a[c == 2 ? K::E : c][r], lane) = own[r];
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
