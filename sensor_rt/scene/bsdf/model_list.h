// All reflection models.
#pragma once

#include <vector>

#include "sensor_rt/scene/bsdf/models.h"

namespace sensor_rt {

const std::vector<const BsdfModel*>& bsdf_models();

}  // namespace sensor_rt
