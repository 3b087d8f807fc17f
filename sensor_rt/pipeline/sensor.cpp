#include "sensor_rt/pipeline/sensor.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>

#include "sensor_rt/optics/region.h"
#include "sensor_rt/pipeline/json_object.h"

namespace sensor_rt {
namespace {

void read_profile(JsonObject& json, LaserSheet& laser) {
  laser.profile_angle = json.numbers("profile_angle");
  laser.profile_power = json.numbers("profile_power");
  if (laser.profile_angle.size() == 1) json.fail("profile_angle", "expected no angle or at least two");
  if (laser.profile_angle.size() != laser.profile_power.size()) {
    json.fail("profile_power", "expected the length of profile_angle");
  }
  if (std::adjacent_find(laser.profile_angle.begin(), laser.profile_angle.end(),
                         std::greater_equal<double>()) != laser.profile_angle.end()) {
    json.fail("profile_angle", "expected ascending angles");
  }
  if (std::any_of(laser.profile_power.begin(), laser.profile_power.end(), [](double p) { return p < 0.0; })) {
    json.fail("profile_power", "must not be negative");
  }
  try {
    laser.normalise_profile();
  } catch (const std::invalid_argument& error) {
    json.fail("profile_power", error.what());
  }
}

/// Rotation about the centre of the source, about sensor Y first, then translation along X.
Rigid3 sheet_pose(double offset_x, double turn_y, double turn_z, double source_z) {
  Rigid3 about_source;
  about_source.rotation = (Eigen::AngleAxisd(turn_z, Eigen::Vector3d::UnitZ()) *
                           Eigen::AngleAxisd(turn_y, Eigen::Vector3d::UnitY()))
                              .toRotationMatrix();
  about_source.translation = {offset_x, 0.0, source_z};
  Rigid3 to_source;
  to_source.translation = {0.0, 0.0, -source_z};
  return about_source * to_source;
}

LaserSheet read_laser(JsonObject json) {
  LaserSheet laser;
  laser.wavelength = json.positive("wavelength");
  laser.power = json.non_negative("power");
  laser.fan_half_angle = json.positive("fan_half_angle");
  if (laser.fan_half_angle >= 0.5 * M_PI) json.fail("fan_half_angle", "must be below pi/2");
  laser.source_z = json.number("source_z");
  laser.sheet_sigma = json.positive("sheet_sigma");
  laser.waist_z = json.number("waist_z");
  laser.divergence = json.non_negative("divergence");
  laser.source_length = json.non_negative("source_length");
  const std::vector<double> straightness = json.numbers("straightness", laser.straightness.size());
  std::copy(straightness.begin(), straightness.end(), laser.straightness.begin());
  read_profile(json, laser);
  laser.sensor_from_sheet =
      sheet_pose(json.number("offset_x"), json.number("turn_y"), json.number("turn_z"), laser.source_z);
  json.finish();
  return laser;
}

double tilt_angle(JsonObject& json, const char* key) {
  const double angle = json.number(key);
  if (!(std::abs(angle) < 0.25 * M_PI)) json.fail(key, "must lie within ±pi/4");
  return angle;
}

/// Reads the pose: that of the paper, then its deviations from the plane of symmetry Y = 0. The camera is
/// rotated about its z (roll), then about its y (pan).
void read_pose(JsonObject& json, Camera& camera) {
  const double baseline = json.positive("baseline");
  const double height = json.number("height");
  camera.tilt = json.number("tilt");
  if (!(std::abs(camera.tilt) < 0.5 * M_PI)) json.fail("tilt", "must lie within ±pi/2");
  camera.sensor_from_camera = sensor_from_camera(camera.side, baseline, height, camera.tilt);
  const double offset_y = json.number("offset_y");
  const double pan = json.number("pan");
  const double roll = json.number("roll");
  camera.is_aligned = offset_y == 0.0 && pan == 0.0 && roll == 0.0;
  if (camera.is_aligned) return;
  Rigid3& pose = camera.sensor_from_camera;
  pose.translation.y() += offset_y;
  pose.rotation = pose.rotation * (Eigen::AngleAxisd(pan, Eigen::Vector3d::UnitY()) *
                                   Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()))
                                      .toRotationMatrix();
}

Camera read_camera(JsonObject& json) {
  Camera camera;
  camera.name = json.text("name");
  camera.side = static_cast<int>(json.integer("side", -1, 1));
  if (camera.side == 0) json.fail("side", "must be 1 or -1");
  read_pose(json, camera);
  camera.width_px = static_cast<int>(json.integer("width_px", 1, 1 << 14));
  camera.height_px = static_cast<int>(json.integer("height_px", 1, 1 << 14));
  camera.focal_px = json.positive("focal_px");
  camera.cx_px = json.number("cx_px");
  camera.cy_px = json.number("cy_px");
  const std::vector<double> distortion = json.numbers("distortion", camera.distortion.size());
  std::copy(distortion.begin(), distortion.end(), camera.distortion.begin());
  camera.f_number = json.positive("f_number");
  camera.pixel_pitch = json.positive("pixel_pitch");
  camera.transmission = json.fraction("transmission");
  camera.tilt_sensor(tilt_angle(json, "scheimpflug_x"), tilt_angle(json, "scheimpflug_y"));
  camera.focus = json.non_negative("focus");
  camera.psf_sigma_px = json.non_negative("psf_sigma_px");
  try {
    require_inverse(camera);
  } catch (const std::invalid_argument& error) {
    json.fail("distortion", error.what());
  }
  json.finish();
  return camera;
}

void read_detector(JsonObject json, Sensor& sensor) {
  DetectorParameters& d = sensor.detector;
  d.exposure = json.positive("exposure");
  d.quantum_efficiency = json.fraction("quantum_efficiency");
  d.full_well_e = json.positive("full_well_e");
  d.read_noise_e = json.non_negative("read_noise_e");
  d.dark_current_e_per_s = json.non_negative("dark_current_e_per_s");
  d.gain_dn_per_e = json.positive("gain_dn_per_e");
  d.bit_depth = static_cast<int>(json.integer("bit_depth", 8, 16));
  d.black_level_dn = json.non_negative("black_level_dn");
  d.prnu = json.fraction("prnu");
  d.dsnu_e = json.non_negative("dsnu_e");
  d.row_noise_e = json.non_negative("row_noise_e");
  d.hot_pixels = json.fraction("hot_pixels");
  d.hot_pixel_e_per_s = json.non_negative("hot_pixel_e_per_s");
  sensor.row_readout = json.non_negative("row_readout");
  sensor.laser_off_frame = json.boolean("laser_off_frame");
  json.finish();
  sensor.image_noise = {d.black_level_dn,
                        d.gain_dn_per_e,
                        std::hypot(d.read_noise_e, d.row_noise_e),  // alike within a column
                        d.full_well_e,
                        d.bit_depth,
                        d.dsnu_e,
                        d.prnu,
                        0.0,
                        0.0};
}

void read_extraction(JsonObject json, Sensor& sensor) {
  ExtractionOptions& e = sensor.extraction;
  // Choices are listed in the order of their enumerations.
  e.detector = static_cast<PeakDetector>(
      json.choice("detector", {"gaussian", "centre_of_gravity", "parabola", "log_parabola", "blais_rioux_4",
                               "blais_rioux_8", "derivative_of_gaussian", "steger"}));
  e.peak =
      static_cast<PeakChoice>(json.choice("peak", {"brightest", "first", "last", "continuity", "agreement"}));
  sensor.triangulation.fusion = static_cast<Fusion>(json.choice("fusion", {"none", "weighted"}));
  e.continuity_px = json.positive("continuity_px");
  e.agreement_px = json.positive("agreement_px");
  sensor.triangulation.agreement_px = e.agreement_px;
  const std::size_t form =
      json.choice("triangulation", {"exact", "eq4_as_printed", "sheet", "eq5_as_printed"});
  if (form == 1) sensor.triangulation.form = TriangulationForm::kEq4AsPrinted;
  if (form == 2) sensor.triangulation.sheet = sensor.laser.surface();
  sensor.range_as_printed = form == 3;
  e.threshold_sigma = json.positive("threshold_sigma");
  e.min_amplitude_dn = json.non_negative("min_amplitude_dn");
  e.min_sigma_px = json.positive("min_sigma_px");
  e.max_sigma_px = json.positive("max_sigma_px");
  e.max_asymmetry = json.positive("max_asymmetry");
  e.max_residual = json.positive("max_residual");
  e.max_row_jump_px = json.positive("max_row_jump_px");
  e.max_amplitude_jump = json.positive("max_amplitude_jump");
  e.max_width_jump = json.positive("max_width_jump");
  e.end_columns = static_cast<int>(json.integer("end_columns", 0, 1 << 14));
  e.min_run_columns = static_cast<int>(json.integer("min_run_columns", 1, 1 << 14));
  json.finish();
}

void read_render(JsonObject json, Sensor& sensor) {
  sensor.samples_per_pixel = static_cast<int>(json.integer("samples_per_pixel", 1, 1024));
  sensor.noise = json.boolean("noise");
  sensor.seed = static_cast<std::uint64_t>(json.integer("seed", 0, std::numeric_limits<long long>::max()));
  sensor.rays_across_fan = static_cast<int>(json.integer("rays_across_fan", 2, 1 << 16));
  sensor.ground_truth = json.choice("mode", {"fast", "path"}) == 1;
  sensor.bounces = static_cast<int>(json.integer("bounces", 0, 64));
  sensor.photons = static_cast<int>(json.integer("photons", 16, 1 << 26));
  json.finish();
}

void read_range(JsonObject json, Sensor& sensor) {
  sensor.near = json.number("near");
  sensor.far = json.number("far");
  if (!(sensor.near < sensor.far)) json.fail("near", "must be below far");
  if (sensor.far > kFarthest) json.fail("far", "must be at most 10 m");
  json.finish();
  sensor.triangulation.near = sensor.near;
  sensor.triangulation.far = sensor.far;
}

}  // namespace

Extractor make_extractor(const Sensor& sensor, bool all_peaks) {
  return {sensor.extraction,
          sensor.image_noise,
          {sensor.cameras, sensor.triangulation.sheet, sensor.laser.source_z, sensor.near, sensor.far},
          all_peaks};
}

Sensor parse_sensor(const std::string& text) {
  nlohmann::json document;
  try {
    document = nlohmann::json::parse(text);
  } catch (const nlohmann::json::exception& error) {
    throw std::invalid_argument(std::string("sensor: not valid JSON: ") + error.what());
  }
  JsonObject json(document, "sensor");
  Sensor sensor;
  json.integer("format", 1, 1);
  sensor.name = json.text("name");
  sensor.laser = read_laser(json.object("laser"));
  read_range(json.object("range"), sensor);
  for (JsonObject& camera : json.objects("cameras")) sensor.cameras.push_back(read_camera(camera));
  read_detector(json.object("detector"), sensor);
  JsonObject ambient = json.object("ambient");
  sensor.ambient_irradiance = ambient.non_negative("irradiance");
  ambient.finish();
  JsonObject band_pass = json.object("band_pass");
  sensor.band_pass = {band_pass.positive("centre"), band_pass.positive("width")};
  band_pass.finish();
  JsonObject speckle = json.object("speckle");
  sensor.speckle_contrast = speckle.fraction("contrast");
  sensor.image_noise.speckle_contrast = sensor.speckle_contrast;
  sensor.image_noise.wavelength = sensor.laser.wavelength;
  speckle.finish();
  read_render(json.object("render"), sensor);
  read_extraction(json.object("extraction"), sensor);
  JsonObject geometric = json.object("geometric");
  sensor.geometric_rays = static_cast<int>(geometric.integer("rays", 1, 1 << 20));
  geometric.finish();
  json.finish();
  if (sensor.row_readout > 0.0 && sensor.bounces > 0) {
    json.fail("render.bounces", "light reflected between surfaces needs a global shutter");
  }
  sensor.image_sensor = std::make_shared<const Detector>(sensor.detector, sensor.noise, sensor.seed);
  return sensor;
}

}  // namespace sensor_rt
