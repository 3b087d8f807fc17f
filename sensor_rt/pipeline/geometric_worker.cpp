#include "sensor_rt/pipeline/geometric_worker.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "sensor_rt/detector/quantile_table.h"
#include "sensor_rt/geometry/multiversion.h"
#include "sensor_rt/geometry/random.h"
#include "sensor_rt/imaging/fuse.h"

namespace sensor_rt {
namespace {

constexpr double kAnywhere = std::numeric_limits<double>::infinity();

/// Sixteen stripes on the image of one camera.
struct alignas(64) Stripes {
  std::int32_t column[kLanes];
  double row[kLanes];
  float height_dn[kLanes];
  float width[kLanes];
  float background_e[kLanes];
};

/// Standard normal numbers.
struct alignas(64) Normals {
  float row[kLanes];
  float height[kLanes];
  float width[kLanes];
};

/// Three words of random bits per lane; the points of a column share them, as in an image.
SENSOR_RT_MULTIVERSION
void draw(std::uint64_t seed, std::int64_t frame, std::int32_t camera, const std::int32_t* columns,
          std::uint32_t (&words)[4][kLanes]) {
  constexpr std::uint32_t kPurpose = 0x2F0A57E5u;  // separates this use of the seed from others
  const auto number = static_cast<std::uint64_t>(frame);
  for (int l = 0; l < kLanes; ++l) {
    words[0][l] = static_cast<std::uint32_t>(columns[l]);
    words[1][l] = static_cast<std::uint32_t>(camera);
    words[2][l] = static_cast<std::uint32_t>(number);
    words[3][l] = static_cast<std::uint32_t>(number >> 32);
  }
  philox4x32(words, {static_cast<std::uint32_t>(seed) ^ kPurpose, static_cast<std::uint32_t>(seed >> 32)});
}

void sample_normals(const std::uint32_t* bits, float* normals) {
  const QuantileTable& table = standard_normal();
  for (int l = 0; l < kLanes; ++l) normals[l] = table.sample(bits[l]);
}

/// Limits of the extraction beyond the stripe response.
struct Limits {
  float amplitude, narrowest, widest;
};

/// Computes rows and amplitudes with their errors; lost[lane] is 1 for stripes that are not detected or
/// rejected. The relative uncertainties of the height and of the pixel-integrated width are about that of the
/// row relative to the width.
SENSOR_RT_MULTIVERSION
void add_noise(const Stripes& __restrict stripes, const StripeResponse::Reading& __restrict stated,
               const StripeResponse::Reading& __restrict truth, const Normals& __restrict normals,
               const Limits& limits, double* __restrict row, float* __restrict intensity,
               std::int32_t* __restrict lost) {
  for (int l = 0; l < kLanes; ++l) {
    const float width = stripes.width[l];
    const float sigma = truth.row_sigma[l];
    const float relative = sigma / width;
    const float seen_width = std::sqrt(width * width + 1.0f / 12.0f);
    const float measured_width = width + relative * seen_width * normals.width[l];
    const float amplitude = stated.amplitude[l] * (1.0f + relative * normals.height[l]);
    row[l] = stripes.row[l] + static_cast<double>(sigma * normals.row[l]);
    intensity[l] = amplitude;
    const bool found = (stated.row_sigma[l] > 0.0f) & (sigma > 0.0f);
    const bool accepted = (amplitude >= limits.amplitude) & (measured_width >= limits.narrowest) &
                          (measured_width <= limits.widest);
    lost[l] = found & accepted ? 0 : 1;
  }
}

/// The shot noise of the dark current is added to the read noise.
ImageNoise with_dark_current(const Sensor& sensor) {
  ImageNoise noise = sensor.image_noise;
  const double dark_e = sensor.detector.dark_current_e_per_s * sensor.detector.exposure;
  noise.read_noise_e = std::sqrt(noise.read_noise_e * noise.read_noise_e + dark_e);
  return noise;
}

FanGeometry fan_geometry(const Sensor& as_built, const Sensor& sensor, bool exact) {
  FanGeometry geometry{
      as_built.cameras,      as_built.laser, exact ? sensor.near : -kAnywhere, exact ? sensor.far : kAnywhere,
      sensor.geometric_rays, std::nullopt};
  if (as_built.noise) {
    geometry.stripes = {as_built.detector.quantum_efficiency, as_built.ambient_irradiance,
                        as_built.band_pass};
  }
  return geometry;
}

bool is_exact(const Sensor& as_built, const Sensor& sensor) {
  const bool on_sheet = as_built.laser.is_nominal() || !sensor.triangulation.sheet.is_nominal();
  return &as_built == &sensor && on_sheet && !as_built.noise &&
         sensor.triangulation.form == TriangulationForm::kExact;
}

std::int32_t nearest(double column) { return static_cast<std::int32_t>(std::floor(column + 0.5)); }

}  // namespace

GeometricWorker::GeometricWorker(const Sensor& as_built, const Sensor& sensor, bool lamps)
    : as_built_(as_built),
      sensor_(sensor),
      exact_(is_exact(as_built, sensor)),
      caster_(fan_geometry(as_built, sensor, exact_)) {
  const bool background = lamps || as_built.ambient_irradiance > 0.0;
  for (std::size_t k = 0; k < sensor.cameras.size(); ++k) {
    triangulators_.emplace_back(sensor.cameras[k], sensor.triangulation.form, sensor.triangulation.sheet);
    if (!as_built.noise) continue;
    const auto response = [&](const Sensor& one) {
      return StripeResponse::shared(sensor.extraction, with_dark_current(one), one.cameras[k],
                                    sensor.laser_off_frame, background);
    };
    stated_.push_back(response(sensor));
    true_.push_back(response(as_built));
  }
}

void GeometricWorker::run(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                          Profiles& out) {
  {
    const Stopwatch watch(seconds_[kCast]);
    caster_.cast(scene, exposures, exposure, points_);
  }
  const Stopwatch watch(seconds_[kTriangulate]);
  const bool fuses = sensor_.triangulation.fusion == Fusion::kWeighted;
  if (fuses || !exact_) measure(frame_number(exposures, exposure, true));
  if (as_built_.noise) trim_runs();
  if (exact_) {
    take_exact(out);
  } else {
    triangulate(out);
  }
  out.frame.assign(out.points_in_sensor.size(), exposures.index[exposure]);
  if (fuses) fuse_points(out);
}

void GeometricWorker::measure(std::int64_t frame) {
  const std::size_t count = points_.size();
  kept_.clear();
  if (!as_built_.noise) {
    for (std::size_t i = 0; i < count; ++i) kept_.push_back(i);
    return;
  }
  measured_.row.resize(count);
  measured_.sigma.resize(count);
  measured_.intensity.resize(count);
  measured_.flags.resize(count);
  for (std::size_t first = 0, next = 0; first < count; first = next) {
    next = first + 1;
    while (next < count && next < first + kLanes && points_.camera[next] == points_.camera[first]) ++next;
    measure_lanes(frame, first, next - first);
  }
}

void GeometricWorker::measure_lanes(std::int64_t frame, std::size_t first, std::size_t count) {
  const auto camera = static_cast<std::size_t>(points_.camera[first]);
  const auto gain = static_cast<float>(as_built_.detector.gain_dn_per_e);
  Stripes stripes;
  for (std::size_t l = 0; l < kLanes; ++l) {
    const std::size_t i = first + std::min(l, count - 1);  // unused lanes repeat the last stripe
    stripes.column[l] = nearest(points_.column[i]);
    stripes.row[l] = points_.row[i];
    stripes.height_dn[l] = gain * points_.height_e[i];
    stripes.width[l] = points_.width[i];
    stripes.background_e[l] = points_.background_e[i];
  }
  StripeResponse::Reading stated;
  StripeResponse::Reading other;
  stated_[camera]->read(stripes.height_dn, stripes.width, stripes.background_e, stated);
  const bool as_stated = true_[camera] == stated_[camera];
  if (!as_stated) true_[camera]->read(stripes.height_dn, stripes.width, stripes.background_e, other);
  alignas(64) std::uint32_t words[4][kLanes];
  draw(as_built_.seed, frame, points_.camera[first], stripes.column, words);
  Normals normals;
  sample_normals(words[0], normals.row);
  sample_normals(words[1], normals.height);
  sample_normals(words[2], normals.width);
  const ExtractionOptions& options = sensor_.extraction;
  const Limits limits{static_cast<float>(options.min_amplitude_dn), static_cast<float>(options.min_sigma_px),
                      static_cast<float>(options.max_sigma_px)};
  alignas(64) double row[kLanes];
  alignas(64) float intensity[kLanes];
  alignas(64) std::int32_t lost[kLanes];
  add_noise(stripes, stated, as_stated ? stated : other, normals, limits, row, intensity, lost);
  for (std::size_t l = 0; l < count; ++l) {
    if (lost[l] != 0) continue;
    kept_.push_back(first + l);
    measured_.row[first + l] = row[l];
    measured_.sigma[first + l] = stated.row_sigma[l];
    measured_.intensity[first + l] = intensity[l];
    measured_.flags[first + l] = stated.saturated[l] >= 0.5f ? kPeakSaturated : 0u;
  }
}

void GeometricWorker::trim_runs() {
  const double ends = sensor_.extraction.end_columns;
  const double shortest = std::max<double>(sensor_.extraction.min_run_columns, 2.0 * ends + 1.0);
  const auto neighbours = [this](std::size_t a, std::size_t b) {
    return points_.camera[a] == points_.camera[b] && std::abs(points_.ray[a] - points_.ray[b]) == 1;
  };
  std::size_t kept = 0;
  for (std::size_t begin = 0, end = 0; begin < kept_.size(); begin = end) {
    end = begin + 1;
    while (end < kept_.size() && neighbours(kept_[end - 1], kept_[end])) ++end;
    const double first = points_.column[kept_[begin]];
    const double last = points_.column[kept_[end - 1]];
    if (last - first + 1.0 < shortest) continue;
    for (std::size_t k = begin; k < end; ++k) {
      const double column = points_.column[kept_[k]];
      if (column - first >= ends && last - column >= ends) kept_[kept++] = kept_[k];
    }
  }
  kept_.resize(kept);
}

void GeometricWorker::take_exact(Profiles& out) {
  const std::size_t count = points_.size();
  out.sigma.assign(count, 0.0f);
  out.flags.assign(count, 0);
  out.column.resize(count);
  for (std::size_t i = 0; i < count; ++i) out.column[i] = nearest(points_.column[i]);
  out.camera.assign(points_.camera.begin(), points_.camera.end());
  out.row.swap(points_.row);
  out.points_in_sensor.swap(points_.point);
  out.intensity.swap(points_.brightness);
}

void GeometricWorker::triangulate(Profiles& out) {
  const bool noise = as_built_.noise;
  const LargeVector<double>& rows = points_.row;
  out.resize(kept_.size());
  out.deviation.resize(noise ? kept_.size() : 0);
  std::size_t to = 0;
  for (std::size_t begin = 0, end = 0; begin < kept_.size(); begin = end) {
    const std::int32_t camera = points_.camera[kept_[begin]];
    alignas(64) double column[kLanes] = {};
    alignas(64) double row[kLanes] = {};
    for (; end < kept_.size() && end < begin + kLanes && points_.camera[kept_[end]] == camera; ++end) {
      column[end - begin] = points_.column[kept_[end]];
      row[end - begin] = noise ? measured_.row[kept_[end]] : rows[kept_[end]];
    }
    Lanes3 point;
    Lanes3 per_row;
    triangulators_[static_cast<std::size_t>(camera)].locate(column, row, point, per_row);
    for (std::size_t k = begin; k < end; ++k) {
      const auto l = static_cast<int>(k - begin);
      const std::size_t i = kept_[k];
      if (!(point.z[l] >= sensor_.near && point.z[l] <= sensor_.far)) continue;
      const float sigma = noise ? measured_.sigma[i] : 0.0f;
      const Eigen::Vector3f deviation = sigma * lane(per_row, l).cast<float>();
      if (noise) out.deviation[to] = deviation;
      out.points_in_sensor[to] = lane(point, l);
      out.sigma[to] = deviation.norm();
      out.camera[to] = camera;
      out.column[to] = nearest(column[l]);
      out.row[to] = row[l];
      out.intensity[to] = noise ? measured_.intensity[i] : points_.brightness[i];
      out.flags[to] = noise ? measured_.flags[i] : 0u;
      kept_[to++] = i;
    }
  }
  kept_.resize(to);
  out.resize(to);
}

void GeometricWorker::fuse_points(Profiles& out) {
  column_.clear();
  ray_.clear();
  for (const std::size_t i : kept_) {
    column_.push_back(points_.column[i]);
    ray_.push_back(points_.ray[i]);
  }
  if (out.is_exact()) out.deviation.assign(out.size(), Eigen::Vector3f::Zero());
  const Sampling sampling{column_.data(), ray_.data()};
  fuse(sensor_.cameras, sensor_.triangulation.sheet, sensor_.triangulation.agreement_px, 0, out, &sampling);
}

}  // namespace sensor_rt
