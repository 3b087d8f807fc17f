// Exact primitives met by packets of rays, in double precision.
#pragma once

#include "sensor_rt/scene/shape.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// First crossing at t > 0 of rays given in the frame of the shape; t is infinite where there is none.
/// Normals point out of solids and along +z of rectangles.
void intersect_primitive(const Shape& shape, const Lanes3& origin, const Lanes3& direction, double* t,
                         Lanes3& normal);

}  // namespace sensor_rt
