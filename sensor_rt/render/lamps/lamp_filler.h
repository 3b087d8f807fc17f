// Lamp light on entire images.
#pragma once

#include "sensor_rt/render/lamps/centre_tracer.h"
#include "sensor_rt/render/lamps/reflected_lamps.h"

namespace sensor_rt {

/// Fills an image with lamp light, using one ray through the centre of a pixel at mid-exposure. Blocks of 8 x
/// 8 pixels that show one flat face with smooth illumination at their corners and centre are interpolated
/// with an error of half a per cent; a detail within one block is missed. `out`: electrons per second,
/// row-major. `reflected`: adds light reflected between surfaces; may be null.
void fill_lamps(const CentreTracer& tracer, const ReflectedLamps* reflected, int width, int height,
                float* out);

}  // namespace sensor_rt
