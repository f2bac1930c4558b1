// The compiled methods of pinograsp: headers alone, without dependencies.
#pragma once

#include "core/approach.hpp"
#include "core/batch.hpp"
#include "core/closing.hpp"
#include "core/depth.hpp"
#include "core/forces.hpp"
#include "core/grip.hpp"
#include "core/multipliers.hpp"
#include "core/online.hpp"
#include "core/pushing.hpp"
#include "core/springs.hpp"
#include "core/touch.hpp"
#include "core/triangles.hpp"
