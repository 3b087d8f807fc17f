#include "sensor_rt/scene/material.h"

#include <algorithm>
#include <stdexcept>

#include "sensor_rt/scene/bsdf/model_list.h"
#include "sensor_rt/scene/bsdf/subsurface.h"

namespace sensor_rt {
namespace {

void require(const std::string& what, const char* name, double value, double least, double most) {
  if (value >= least && value <= most) return;
  throw std::invalid_argument(what + ": " + name + " must lie in " + std::to_string(least) + ".." +
                              std::to_string(most) + ", got " + std::to_string(value));
}

const BsdfModel& find_model(const std::string& name, const std::string& what) {
  std::string expected;
  for (const BsdfModel* model : bsdf_models()) {
    if (name == model->name) return *model;
    expected += (expected.empty() ? "" : ", ") + std::string(model->name);
  }
  throw std::invalid_argument(what + ": model: expected one of " + expected + ", got " + name);
}

}  // namespace

void validate_material(const Material& material, const std::string& what) {
  const BsdfModel& model = find_model(material.model, what);
  require(what, "reflectance", material.reflectance, 0.0, 1.0);
  require(what, "roughness", material.roughness, model.min_roughness, 1.0);
  require(what, "refractive_index", material.refractive_index, 1.0, 3.0);
  if (material.scattering != 0.0) {
    if (material.model != "rough_dielectric") {
      throw std::invalid_argument(what + ": scattering belongs to rough_dielectric, not " + material.model);
    }
    require(what, "scattering", material.scattering, Subsurface::kLeastScattering,
            Subsurface::kMostScattering);
    require(what, "reflectance (with scattering)", material.reflectance, 0.01, Subsurface::kMostReflectance);
  }
  if (!model.has_grooves) return;
  require(what, "roughness_along", material.roughness_along, model.min_roughness, 1.0);
  if (!(material.grooves.axis.norm() > 0.0) || !material.grooves.axis.allFinite() ||
      !material.grooves.centre.allFinite()) {
    throw std::invalid_argument(what + ": " + model.name + " needs a groove_axis other than zero");
  }
}

std::unique_ptr<const Bsdf> make_bsdf(const Material& material) {
  return find_model(material.model, "material").make(material);
}

}  // namespace sensor_rt
