// A convex hull as a collision shape of the dynamics engine.
#pragma once

#include <dart/dynamics/SmartPointer.hpp>

#include "fmu/model/support_hull.h"

namespace robotcell {

/// Builds a mesh shape that owns its data.
dart::dynamics::ShapePtr make_hull_shape(const Hull& hull);

}  // namespace robotcell
