#include <pybind11/stl.h>

#include <optional>
#include <stdexcept>
#include <string>

#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/scene/bsdf/subsurface.h"
#include "sensor_rt/scene/shape.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

Material make_material(double reflectance, const std::string& model, double roughness,
                       double refractive_index, double roughness_along,
                       const std::optional<Doubles>& groove_axis, const std::optional<Doubles>& groove_centre,
                       double scattering) {
  Material material{model, reflectance, roughness, refractive_index, roughness_along, {}, scattering};
  if (groove_axis) material.grooves.axis = to_vector3(*groove_axis, "groove_axis");
  material.grooves.around = groove_centre.has_value();
  if (groove_centre) material.grooves.centre = to_vector3(*groove_centre, "groove_centre");
  validate_material(material, "material");
  return material;
}

/// A surface in z = 0 of the body frame, seen at the origin.
SurfaceFrame frame_at_origin(const Material& material) {
  Shape shape;
  shape.grooves = material.grooves;
  return shape.frame(Rigid3(), Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitZ());
}

/// Returns row i of an (n, 3) array as a unit vector.
Eigen::Vector3d unit_row(const Doubles& rows, py::ssize_t i) {
  return Eigen::Map<const Eigen::Vector3d>(rows.data(i, 0)).normalized();
}

py::array_t<double> pi_brdf(const Material& material, const Doubles& a, const Doubles& b) {
  require_shape(a, "a", {-1, 3});
  require_shape(b, "b", {a.shape(0), 3});
  const auto bsdf = make_bsdf(material);
  const SurfaceFrame surface = frame_at_origin(material);
  py::array_t<double> result(a.shape(0));
  for (py::ssize_t i = 0; i < a.shape(0); ++i) {
    result.mutable_at(i) = bsdf->pi_brdf(surface, unit_row(a, i), unit_row(b, i));
  }
  return result;
}

std::optional<double> scattering_albedo(const Material& material) {
  const auto bsdf = make_bsdf(material);
  if (bsdf->subsurface() == nullptr) return std::nullopt;
  return bsdf->subsurface()->albedo();
}

py::array_t<double> albedo(const Material& material, const Doubles& cosine) {
  require_shape(cosine, "cosine", {-1});
  const auto bsdf = make_bsdf(material);
  py::array_t<double> result(cosine.shape(0));
  for (py::ssize_t i = 0; i < cosine.shape(0); ++i) result.mutable_at(i) = bsdf->albedo(cosine.at(i));
  return result;
}

py::tuple sample(const Material& material, const Doubles& from, const Doubles& uniforms) {
  require_shape(from, "from_direction", {-1, 3});
  const py::ssize_t count = from.shape(0);
  require_shape(uniforms, "uniforms", {count, 3});
  const auto bsdf = make_bsdf(material);
  const SurfaceFrame surface = frame_at_origin(material);
  py::array_t<double> towards({count, py::ssize_t{3}});
  py::array_t<double> weight(count);
  py::array_t<double> pdf(count);
  for (py::ssize_t i = 0; i < count; ++i) {
    const BsdfSample s =
        bsdf->sample(surface, unit_row(from, i), uniforms.at(i, 0), uniforms.at(i, 1), uniforms.at(i, 2));
    Eigen::Map<Eigen::Vector3d>(towards.mutable_data(i, 0)) = s.towards;
    weight.mutable_at(i) = s.weight;
    pdf.mutable_at(i) = s.pdf;
  }
  return py::make_tuple(towards, weight, pdf);
}

}  // namespace

Material to_material(const py::object& value) {
  if (py::isinstance<Material>(value)) return value.cast<Material>();
  try {
    Material material;
    material.reflectance = value.cast<double>();
    return material;
  } catch (const py::cast_error&) {
    throw py::type_error("material: expected a Material or the reflectance of a Lambertian surface");
  }
}

void bind_material(py::module_& module) {
  py::class_<Material>(module, "Material", py::module_local())
      .def(py::init([](double reflectance) {
             return make_material(reflectance, "lambert", 0.0, 1.0, 0.0, {}, {}, 0.0);
           }),
           py::arg("reflectance"))
      .def(py::init(&make_material), py::arg("reflectance"), py::arg("model"), py::arg("roughness"),
           py::arg("refractive_index"), py::arg("roughness_along") = 0.0, py::arg("groove_axis") = py::none(),
           py::arg("groove_centre") = py::none(), py::arg("scattering") = 0.0)
      .def_readonly("model", &Material::model)
      .def_readonly("reflectance", &Material::reflectance)
      .def_readonly("roughness", &Material::roughness)
      .def_readonly("refractive_index", &Material::refractive_index)
      .def_readonly("roughness_along", &Material::roughness_along)
      .def_readonly("scattering", &Material::scattering)
      .def_property_readonly("scattering_albedo", &scattering_albedo)
      .def("pi_brdf", &pi_brdf, py::arg("a"), py::arg("b"))
      .def("albedo", &albedo, py::arg("cosine"))
      .def("sample", &sample, py::arg("from_direction"), py::arg("uniforms"));
}

}  // namespace sensor_rt
