#include "sensor_rt/pipeline/scan.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include "sensor_rt/fan/fan_caster.h"
#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/render/image_renderer.h"

namespace sensor_rt {
namespace {

using Clock = std::chrono::steady_clock;

/// Adds the time since construction to an account.
class Stopwatch {
 public:
  explicit Stopwatch(double& account) : account_(account), start_(Clock::now()) {}
  ~Stopwatch() { account_ += std::chrono::duration<double>(Clock::now() - start_).count(); }
  Stopwatch(const Stopwatch&) = delete;
  Stopwatch& operator=(const Stopwatch&) = delete;

 private:
  double& account_;
  Clock::time_point start_;
};

void validate(const Scene& scene, const Exposures& exposures) {
  if (exposures.bodies != scene.bodies().size()) {
    throw std::invalid_argument("the exposures give poses of " + std::to_string(exposures.bodies) +
                                " bodies, the scene holds " + std::to_string(scene.bodies().size()));
  }
}

struct ImageSize {
  int width = 0;
  int height = 0;
  std::size_t pixels() const { return static_cast<std::size_t>(width) * static_cast<std::size_t>(height); }
};

ImageSize common_size(const Sensor& sensor) {
  const Camera& first = sensor.cameras.front();
  for (const Camera& camera : sensor.cameras) {
    if (camera.width_px != first.width_px || camera.height_px != first.height_px) {
      throw std::invalid_argument("camera " + camera.name + " differs in size from camera " + first.name +
                                  ": their images do not fit one array");
    }
  }
  return {first.width_px, first.height_px};
}

RenderSettings render_settings(const Sensor& sensor, bool whole_image) {
  RenderSettings settings;
  settings.model = sensor;
  settings.quantum_efficiency = sensor.detector.quantum_efficiency;
  settings.samples_per_pixel = sensor.samples_per_pixel;
  settings.rays_across_fan = sensor.rays_across_fan;
  settings.whole_image = whole_image;
  return settings;
}

/// Light and detector of one thread.
struct ImageMaker {
  ImageMaker(const RenderPlan& plan, const Detector& shared) : renderer(plan), detector(shared) {}

  void render(const Scene& scene, const Exposures& exposures, std::size_t exposure) {
    const Stopwatch watch(seconds[kRender]);
    renderer.render(scene, exposures, exposure, light);
  }

  void expose(const Exposures& exposures, std::size_t exposure, std::size_t camera,
              ImageView<std::uint16_t> out) {
    const Stopwatch watch(seconds[kDetect]);
    const FrameId id{exposures.index[exposure], static_cast<int>(camera), exposures.duration[exposure]};
    const SparseImage& image = light[camera];
    detector.expose(id, image.pixels.data(), image.electrons.data(), image.pixels.size(), out);
  }

  ImageRenderer renderer;
  const Detector& detector;
  std::vector<SparseImage> light;
  std::array<double, kStationCount> seconds{};
};

/// All stations of one thread.
class RayTracedLine {
 public:
  RayTracedLine(const Sensor& sensor, const RenderPlan& plan, const Detector& detector)
      : sensor_(sensor), maker_(plan, detector), extractor_(sensor.extraction, sensor.image_noise) {}

  /// `kept` receives the images when it is not null.
  void run(const Scene& scene, const Exposures& exposures, std::size_t exposure, std::uint16_t* kept,
           Profiles& out) {
    maker_.render(scene, exposures, exposure);
    peaks_.clear();
    for (std::size_t c = 0; c < sensor_.cameras.size(); ++c) {
      const Camera& camera = sensor_.cameras[c];
      const ImageSize size{camera.width_px, camera.height_px};
      if (kept == nullptr) scratch_.resize(size.pixels());
      std::uint16_t* pixels = kept == nullptr ? scratch_.data() : kept + c * size.pixels();
      const ImageView<std::uint16_t> image{pixels, size.width, size.height, size.width};
      maker_.expose(exposures, exposure, c, image);
      const Stopwatch watch(maker_.seconds[kExtract]);
      extractor_.extract({pixels, size.width, size.height, size.width}, exposures.index[exposure],
                         static_cast<int>(c), peaks_);
    }
    const Stopwatch watch(maker_.seconds[kTriangulate]);
    triangulate(peaks_, sensor_.cameras, sensor_.triangulation, out);
  }

  const std::array<double, kStationCount>& seconds() const { return maker_.seconds; }

 private:
  const Sensor& sensor_;
  ImageMaker maker_;
  Extractor extractor_;
  std::vector<std::uint16_t> scratch_;
  Peaks peaks_;
};

/// The geometric mode of one thread.
class GeometricLine {
 public:
  explicit GeometricLine(const Sensor& sensor)
      : caster_({sensor.cameras, sensor.laser, sensor.near, sensor.far, sensor.geometric_rays}) {}

  void run(const Scene& scene, const Exposures& exposures, std::size_t exposure, Profiles& out) {
    const Stopwatch watch(seconds_[kCast]);
    caster_.cast(scene, exposures, exposure, points_);
    const std::size_t count = points_.point.size();
    out.frame.assign(count, exposures.index[exposure]);
    out.camera = points_.camera;
    out.points_in_sensor = points_.point;
    // These points are exact: no uncertainty, and the brightness of a facing white surface counts as 1.
    out.covariance.assign(count, Eigen::Matrix3d::Zero());
    out.sigma.assign(count, 0.0f);
    out.intensity.assign(points_.brightness.begin(), points_.brightness.end());
    out.flags.assign(count, 0);
    out.column.resize(count);
    out.row.resize(count);
    for (std::size_t i = 0; i < count; ++i) {
      out.column[i] = static_cast<std::int32_t>(std::lround(points_.pixel[i].x()));
      out.row[i] = points_.pixel[i].y();
    }
  }

  const std::array<double, kStationCount>& seconds() const { return seconds_; }

 private:
  FanCaster caster_;
  FanPoints points_;
  std::array<double, kStationCount> seconds_{};
};

/// Runs body(line of this thread, exposure) for every exposure, with lines made on their own threads, and
/// returns the lines that were used.
template <typename Line, typename Make, typename Body>
std::vector<std::unique_ptr<Line>> run_lines(std::size_t count, unsigned threads, const Make& make,
                                             const Body& body) {
  std::vector<std::unique_ptr<Line>> lines(thread_count(threads, count));
  parallel_for(count, threads, [&](std::size_t exposure, unsigned worker) {
    if (!lines[worker]) lines[worker] = make();
    body(*lines[worker], exposure);
  });
  return lines;
}

template <typename Line>
void add_seconds(const std::vector<std::unique_ptr<Line>>& lines, ScanResult& result) {
  for (const auto& line : lines) {
    for (std::size_t s = 0; line && s < result.seconds.size(); ++s) result.seconds[s] += line->seconds()[s];
  }
}

}  // namespace

ScanResult scan(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                const ScanOptions& options) {
  validate(scene, exposures);
  ScanResult result;
  std::vector<Profiles> profiles(exposures.count);
  if (options.engine == Engine::kGeometric) {
    const auto lines = run_lines<GeometricLine>(
        exposures.count, options.threads, [&] { return std::make_unique<GeometricLine>(sensor); },
        [&](GeometricLine& line, std::size_t e) { line.run(scene, exposures, e, profiles[e]); });
    add_seconds(lines, result);
  } else {
    const RenderPlan plan(render_settings(sensor, false));
    const Detector detector(sensor.detector, sensor.noise, sensor.seed);
    const std::size_t stride = options.keep_images ? sensor.cameras.size() * common_size(sensor).pixels() : 0;
    result.images.resize(exposures.count * stride);
    const auto lines = run_lines<RayTracedLine>(
        exposures.count, options.threads,
        [&] { return std::make_unique<RayTracedLine>(sensor, plan, detector); },
        [&](RayTracedLine& line, std::size_t e) {
          line.run(scene, exposures, e, stride > 0 ? &result.images[e * stride] : nullptr, profiles[e]);
        });
    add_seconds(lines, result);
  }
  std::size_t total = 0;
  for (const Profiles& profile : profiles) total += profile.size();
  result.profiles.reserve(total);
  for (const Profiles& profile : profiles) result.profiles.append(profile);
  return result;
}

std::vector<std::uint16_t> render_images(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                         unsigned threads) {
  validate(scene, exposures);
  const ImageSize size = common_size(sensor);
  const std::size_t cameras = sensor.cameras.size();
  const RenderPlan plan(render_settings(sensor, false));
  const Detector detector(sensor.detector, sensor.noise, sensor.seed);
  std::vector<std::uint16_t> images(exposures.count * cameras * size.pixels());
  run_lines<ImageMaker>(
      exposures.count, threads, [&] { return std::make_unique<ImageMaker>(plan, detector); },
      [&](ImageMaker& maker, std::size_t e) {
        maker.render(scene, exposures, e);
        for (std::size_t c = 0; c < cameras; ++c) {
          maker.expose(exposures, e, c,
                       {&images[(e * cameras + c) * size.pixels()], size.width, size.height, size.width});
        }
      });
  return images;
}

std::vector<float> expected_electrons(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                      bool whole_image, unsigned threads) {
  validate(scene, exposures);
  const ImageSize size = common_size(sensor);
  const std::size_t cameras = sensor.cameras.size();
  std::vector<float> images(exposures.count * cameras * size.pixels(), 0.0f);
  const RenderPlan plan(render_settings(sensor, whole_image));
  run_lines<ImageRenderer>(
      exposures.count, threads, [&] { return std::make_unique<ImageRenderer>(plan); },
      [&](ImageRenderer& renderer, std::size_t e) {
        std::vector<SparseImage> light;
        renderer.render(scene, exposures, e, light);
        for (std::size_t c = 0; c < cameras; ++c) {
          float* image = &images[(e * cameras + c) * size.pixels()];
          for (std::size_t i = 0; i < light[c].pixels.size(); ++i)
            image[light[c].pixels[i]] = light[c].electrons[i];
        }
      });
  return images;
}

}  // namespace sensor_rt
