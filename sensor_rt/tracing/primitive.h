// Intersection of packets of rays with exact primitives, in double precision.
#pragma once

#include "sensor_rt/scene/shape.h"
#include "sensor_rt/tracing/packet.h"

namespace sensor_rt {

/// Computes the first intersection at t > 0 of rays given in the frame of the shape; t is infinite without a
/// hit. Normals point outwards on solids and along +z on rectangles.
void intersect_primitive(const Shape& shape, const Lanes3& origin, const Lanes3& direction, double* t,
                         Lanes3& normal);

}  // namespace sensor_rt
