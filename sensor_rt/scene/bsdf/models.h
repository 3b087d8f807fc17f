// Registration of reflection models. Every file of this folder that is listed as a model in CMakeLists.txt
// (all but the shared ones) defines one BsdfModel named bsdf_<file>; the list is generated from the files.
#pragma once

#include <memory>

#include "sensor_rt/scene/bsdf/bsdf.h"
#include "sensor_rt/scene/material.h"

namespace sensor_rt {

struct BsdfModel {
  const char* name;      ///< in descriptions
  double min_roughness;  ///< smallest valid roughness
  std::unique_ptr<const Bsdf> (*make)(const Material& material);
  bool has_grooves = false;
};

template <typename Model>
std::unique_ptr<const Bsdf> make_bsdf_of(const Material& material) {
  return std::make_unique<const Model>(material);
}

}  // namespace sensor_rt
