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
    double (*a)[K::M][width] = reinterpret_cast<double (*)[K::M][width]>(block.a);
    const double x = point[0] / arm, y = point[1] / arm, z = point[2] / arm;
    for (int c = 0; c < 3; ++c) {
        const int j = c == 2 ? K::E : c;
        const double size = c == 2 ? 1.0 : mu;
        const double u = size * rotation[c], v = size * rotation[3 + c], w = size * rotation[6 + c];
        a[j][0][lane] = u;
        a[j][1][lane] = v;
        a[j][2][lane] = w;
        a[j][3][lane] = y * w - z * v;
        a[j][4][lane] = z * u - x * w;
        a[j][5][lane] = x * v - y * u;
    }
    if constexpr (K::D == 4)
        for (int r = 0; r < K::M; ++r) a[2][r][lane] = r < 3 ? 0.0 : rotation[3 * (r - 3) + 2] * torsion / arm;
}

// The unit of component j of a contact: [N], [N m] for torsion, per newton at the friction limit.
template <class K>
PINOGRASP_INLINE double unit_of(int j, double mu, double torsion) {
    return j == K::E ? 1.0 : j == 2 ? torsion : mu;
}

// A number of one lane.
PINOGRASP_INLINE double& in_lane(Vector& vector, int lane) { return reinterpret_cast<double*>(&vector)[lane]; }
PINOGRASP_INLINE double in_lane(const Vector& vector, int lane) {
    return reinterpret_cast<const double*>(&vector)[lane];
}

}  // namespace PINOGRASP_CORE_LEVEL
}  // namespace pinograsp::core
