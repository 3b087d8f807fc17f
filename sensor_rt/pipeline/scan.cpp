#include "sensor_rt/pipeline/scan.h"

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/pipeline/lines.h"
#include "sensor_rt/pipeline/ordered_profiles.h"

namespace sensor_rt {
namespace {

void validate(const Scene& scene, const Exposures& exposures) {
  if (exposures.bodies != scene.bodies().size()) {
    throw std::invalid_argument("the exposures give poses of " + std::to_string(exposures.bodies) +
                                " bodies, the scene holds " + std::to_string(scene.bodies().size()));
  }
}

void require_same_images(const Sensor& as_built, const Sensor& sensor) {
  const auto same = [](const Camera& a, const Camera& b) {
    return a.width_px == b.width_px && a.height_px == b.height_px;
  };
  if (!std::equal(as_built.cameras.begin(), as_built.cameras.end(), sensor.cameras.begin(),
                  sensor.cameras.end(), same)) {
    throw std::invalid_argument("the sensor as built differs in the number or size of its cameras");
  }
}

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

/// The most points that one exposure can give.
std::size_t points_per_exposure(const Sensor& sensor, Engine engine) {
  std::size_t points = 0;
  for (const Camera& camera : sensor.cameras) {
    points +=
        static_cast<std::size_t>(engine == Engine::kGeometric ? sensor.geometric_rays : camera.width_px);
  }
  return points;
}

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

/// Seconds of all lines together.
template <typename Line>
StationSeconds sum_seconds(const std::vector<std::unique_ptr<Line>>& lines) {
  StationSeconds sum{};
  for (const auto& line : lines) {
    for (std::size_t s = 0; line && s < sum.size(); ++s) sum[s] += line->seconds()[s];
  }
  return sum;
}

}  // namespace

ScanResult scan(const Scene& scene, const Sensor& as_built, const Sensor& sensor, const Exposures& exposures,
                const ScanOptions& options) {
  validate(scene, exposures);
  require_same_images(as_built, sensor);
  ScanResult result;
  OrderedProfiles ordered(exposures.count * points_per_exposure(sensor, options.engine));
  if (options.engine == Engine::kGeometric) {
    const auto lines = run_lines<GeometricLine>(
        exposures.count, options.threads, [&] { return std::make_unique<GeometricLine>(as_built, sensor); },
        [&](GeometricLine& line, std::size_t e) {
          Profiles profiles = ordered.borrow();
          line.run(scene, exposures, e, profiles);
          ordered.hand_in(e, std::move(profiles));
        });
    result.seconds = sum_seconds(lines);
  } else {
    const RenderPlan plan(render_settings(as_built, false));
    const Detector detector(as_built.detector, as_built.noise, as_built.seed);
    const std::size_t stride = options.keep_images ? sensor.cameras.size() * common_size(sensor).pixels() : 0;
    std::unique_ptr<RenderPlan> unlit;
    if (sensor.laser_off_frame) {
      unlit = std::make_unique<RenderPlan>(render_settings(as_built, false, false));
      result.unlit.resize(exposures.count * stride);
    }
    result.images.resize(exposures.count * stride);
    const auto kept = [&](std::size_t e) {
      RayTracedLine::Kept to;
      if (!result.images.empty()) to.lit = &result.images[e * stride];
      if (!result.unlit.empty()) to.unlit = &result.unlit[e * stride];
      return to;
    };
    const auto lines = run_lines<RayTracedLine>(
        exposures.count, options.threads,
        [&] { return std::make_unique<RayTracedLine>(sensor, plan, unlit.get(), detector); },
        [&](RayTracedLine& line, std::size_t e) {
          Profiles profiles = ordered.borrow();
          line.run(scene, exposures, e, kept(e), profiles);
          ordered.hand_in(e, std::move(profiles));
        });
    result.seconds = sum_seconds(lines);
  }
  result.profiles = ordered.take();
  return result;
}

std::vector<std::uint16_t> render_images(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                         bool laser_on, unsigned threads) {
  validate(scene, exposures);
  const ImageSize size = common_size(sensor);
  const std::size_t cameras = sensor.cameras.size();
  const RenderPlan plan(render_settings(sensor, false, laser_on));
  const Detector detector(sensor.detector, sensor.noise, sensor.seed);
  std::vector<std::uint16_t> images(exposures.count * cameras * size.pixels());
  run_lines<ImageLine>(
      exposures.count, threads, [&] { return std::make_unique<ImageLine>(plan, detector); },
      [&](ImageLine& line, std::size_t e) {
        line.render(scene, exposures, e);
        for (std::size_t c = 0; c < cameras; ++c) {
          line.expose(exposures, e, c,
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
