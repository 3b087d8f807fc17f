// Python bindings of imaging: images to peaks to profiles.
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sensor_rt/bindings/arrays.h"
#include "sensor_rt/bindings/bindings.h"
#include "sensor_rt/bindings/image_stack.h"
#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/imaging/extract.h"
#include "sensor_rt/imaging/triangulate.h"

namespace py = pybind11;

namespace sensor_rt {
namespace {

/// Returns a read-only array that refers to memory of `owner`.
template <typename T>
py::array view(const py::object& owner, const T* data, std::vector<py::ssize_t> shape) {
  py::array array(py::dtype::of<T>(), std::move(shape), data, owner);
  array.attr("flags").attr("writeable") = false;
  return array;
}

/// Defines a property that exposes a member vector as an array of shape (n).
template <typename Owner, typename Vector, typename Class>
void bind_vector(Class& bound, const char* name, Vector Owner::*member) {
  bound.def_property_readonly(name, [member](const py::object& self) {
    const auto& values = self.cast<const Owner&>().*member;
    return view(self, values.data(), {static_cast<py::ssize_t>(values.size())});
  });
}

Peaks extract(const py::array& images, const Sensor& sensor, unsigned threads, bool all_peaks,
              const std::optional<py::array>& background) {
  const ImageStack<std::uint16_t> stack("images", images, sensor);
  std::optional<ImageStack<std::uint16_t>> laser_off;
  if (background) {
    laser_off.emplace("background", *background, sensor);
    if (laser_off->frames() != stack.frames()) {
      throw std::invalid_argument("background: expected " + std::to_string(stack.frames()) + " frames, got " +
                                  describe(*background));
    }
  }
  const py::gil_scoped_release release;
  std::vector<Extractor> extractors;
  for (unsigned k = 0; k < thread_count(threads, stack.frames()); ++k) {
    extractors.push_back(make_extractor(sensor, all_peaks));
  }
  std::vector<Peaks> found(stack.frames());
  parallel_for(stack.frames(), threads, [&](std::size_t frame, unsigned worker) {
    for (std::size_t camera = 0; camera < stack.cameras(); ++camera) {
      const std::size_t image = frame * stack.cameras() + camera;
      if (laser_off) {
        extractors[worker].measure(stack.image(image), laser_off->image(image), static_cast<int>(camera));
      } else {
        extractors[worker].measure(stack.image(image), static_cast<int>(camera));
      }
    }
    extractors[worker].finish(static_cast<std::int64_t>(frame), found[frame]);
  });
  Peaks all;
  for (const Peaks& peaks : found) all.append(peaks);
  return all;
}

/// Computed on access: it is rarely used and larger than all other arrays together.
py::array_t<double> covariance(const Profiles& profiles) {
  std::vector<double> values(9 * profiles.size(), 0.0);
  for (std::size_t i = 0; i < profiles.deviation.size(); ++i) {
    const Eigen::Vector3d d = profiles.deviation[i].cast<double>();
    Eigen::Map<Eigen::Matrix3d> to(&values[9 * i]);
    to = d * d.transpose();
  }
  return to_array(std::move(values), {static_cast<py::ssize_t>(profiles.size()), 3, 3});
}

Profiles triangulate_peaks(const Peaks& peaks, const Sensor& sensor, bool keep_rejected) {
  TriangulationOptions options = sensor.triangulation;
  options.keep_rejected = keep_rejected;
  Profiles profiles;
  const py::gil_scoped_release release;
  triangulate(peaks, sensor.cameras, options, profiles);
  return profiles;
}

using Pixels = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;
using Points = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

const Camera& camera_of(const Sensor& sensor, int camera) {
  if (camera < 0 || static_cast<std::size_t>(camera) >= sensor.cameras.size()) {
    throw std::invalid_argument("camera " + std::to_string(camera) + ": the sensor has " +
                                std::to_string(sensor.cameras.size()));
  }
  return sensor.cameras[static_cast<std::size_t>(camera)];
}

Points triangulate_pixels(const Pixels& pixels, const Sensor& sensor, int camera, const std::string& form) {
  const SheetSurface sheet = form == "sheet" ? sensor.laser.surface() : SheetSurface{};
  const auto on_sheet = [&](const Camera& c, const Eigen::Vector2d& p) {
    return triangulate_exact(c, sheet, p);
  };
  std::function<Eigen::Vector3d(const Camera&, const Eigen::Vector2d&)> locate;
  if (form == "exact" || form == "sheet" || form == "eq5_as_printed") locate = on_sheet;
  if (form == "ray") locate = triangulate_ray;
  if (form == "eq4_as_printed") locate = triangulate_eq4_as_printed;
  if (!locate) {
    throw std::invalid_argument("form \"" + form +
                                "\": expected exact, sheet, ray, eq4_as_printed or eq5_as_printed");
  }
  const Camera& optics = camera_of(sensor, camera);
  Points points(pixels.rows(), 3);
  for (Eigen::Index i = 0; i < pixels.rows(); ++i) points.row(i) = locate(optics, pixels.row(i));
  return points;
}

void bind_peaks(py::module_& module) {
  py::class_<Peaks> peaks(module, "Peaks", py::module_local());
  peaks.def("__len__", &Peaks::size);
  bind_vector(peaks, "frame", &Peaks::frame);
  bind_vector(peaks, "camera", &Peaks::camera);
  bind_vector(peaks, "column", &Peaks::column);
  bind_vector(peaks, "row", &Peaks::row);
  bind_vector(peaks, "amplitude", &Peaks::amplitude);
  bind_vector(peaks, "width", &Peaks::width);
  bind_vector(peaks, "row_sigma", &Peaks::row_sigma);
  bind_vector(peaks, "asymmetry", &Peaks::asymmetry);
  bind_vector(peaks, "residual", &Peaks::residual);
  bind_vector(peaks, "flags", &Peaks::flags);
  py::dict flags;
  for (const auto& [name, bit] : {std::pair{"saturated", kPeakSaturated},
                                  {"border", kPeakBorder},
                                  {"asymmetric", kPeakAsymmetric},
                                  {"wide", kPeakWide},
                                  {"narrow", kPeakNarrow},
                                  {"weak", kPeakWeak},
                                  {"multiple", kPeakMultiple},
                                  {"step", kPeakStep},
                                  {"residual", kPeakResidual},
                                  {"end", kPeakEnd},
                                  {"not_converged", kPeakNotConverged},
                                  {"overlap", kPeakOverlap},
                                  {"passed_over", kPeakPassedOver},
                                  {"unconfirmed", kPeakUnconfirmed}}) {
    flags[name] = static_cast<std::uint32_t>(bit);
  }
  module.attr("PEAK_FLAGS") = flags;
  module.attr("PEAK_REJECTED") = kPeakRejected;
}

void bind_profiles(py::module_& module) {
  py::class_<Profiles> profiles(module, "Profiles", py::module_local());
  profiles.def("__len__", &Profiles::size);
  profiles.def_property_readonly("points_in_sensor", [](const py::object& self) {
    const auto& points = self.cast<const Profiles&>().points_in_sensor;
    return view(self, reinterpret_cast<const double*>(points.data()),
                {static_cast<py::ssize_t>(points.size()), 3});
  });
  profiles.def_property_readonly("covariance", &covariance);
  bind_vector(profiles, "sigma", &Profiles::sigma);
  bind_vector(profiles, "intensity", &Profiles::intensity);
  bind_vector(profiles, "camera", &Profiles::camera);
  bind_vector(profiles, "column", &Profiles::column);
  bind_vector(profiles, "row", &Profiles::row);
  bind_vector(profiles, "frame", &Profiles::frame);
  bind_vector(profiles, "flags", &Profiles::flags);
}

}  // namespace

void bind_imaging(py::module_& module) {
  bind_peaks(module);
  bind_profiles(module);
  module.def("extract", &extract, py::arg("images"), py::arg("sensor"), py::arg("threads") = 0u,
             py::arg("all_peaks") = false, py::arg("background") = py::none());
  module.def("triangulate", &triangulate_peaks, py::arg("peaks"), py::arg("sensor"),
             py::arg("keep_rejected") = false);
  module.def("triangulate_pixels", &triangulate_pixels, py::arg("pixels"), py::arg("sensor"),
             py::arg("camera"), py::arg("form"));
}

}  // namespace sensor_rt
