#include "sensor_rt/pipeline/scan.h"

#include <algorithm>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>

#include "sensor_rt/geometry/parallel.h"
#include "sensor_rt/pipeline/geometric_worker.h"
#include "sensor_rt/pipeline/ordered_profiles.h"
#include "sensor_rt/pipeline/workers.h"

namespace sensor_rt {
namespace {

void validate(const Scene& scene, const Exposures& exposures) {
  if (exposures.bodies != scene.bodies().size()) {
    throw std::invalid_argument("the exposures give poses of " + std::to_string(exposures.bodies) +
                                " bodies, the scene has " + std::to_string(scene.bodies().size()));
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
                                  ": their images cannot share one array");
    }
  }
  return {first.width_px, first.height_px};
}

/// Returns the largest possible number of points per exposure.
std::size_t points_per_exposure(const Sensor& sensor, Engine engine) {
  std::size_t points = 0;
  for (const Camera& camera : sensor.cameras) {
    points +=
        static_cast<std::size_t>(engine == Engine::kGeometric ? sensor.geometric_rays : camera.width_px);
  }
  return points;
}

/// Runs body(worker of this thread, exposure) for every exposure, with workers created on their own threads;
/// returns the workers.
template <typename Worker, typename Make, typename Body>
std::vector<std::unique_ptr<Worker>> run_workers(std::size_t count, unsigned threads, const Make& make,
                                                 const Body& body) {
  std::vector<std::unique_ptr<Worker>> workers(thread_count(threads, count));
  parallel_for(count, threads, [&](std::size_t exposure, unsigned thread) {
    if (!workers[thread]) workers[thread] = make();
    body(*workers[thread], exposure);
  });
  return workers;
}

/// Returns the seconds summed over all workers.
template <typename Worker>
StageSeconds sum_seconds(const std::vector<std::unique_ptr<Worker>>& workers) {
  StageSeconds sum{};
  for (const auto& worker : workers) {
    for (std::size_t s = 0; worker && s < sum.size(); ++s) sum[s] += worker->seconds()[s];
  }
  return sum;
}

}  // namespace

void check_engine(const Sensor& sensor, Engine engine) {
  if (engine != Engine::kGeometric) return;
  const auto reject = [](const std::string& key, const std::string& reason) {
    throw std::invalid_argument("sensor." + key + ": the geometric engine " + reason +
                                "; use the ray-traced engine");
  };
  if (sensor.row_readout > 0.0) {
    reject("detector.shutter = \"rolling\"", "exposes all rows simultaneously");
  }
  if (sensor.ground_truth) reject("render.mode = \"path\"", "makes no images");
  if (sensor.bounces > 0) {
    reject("render.bounces = " + std::to_string(sensor.bounces), "does not simulate light between surfaces");
  }
}

ScanResult scan(const Scene& scene, const Sensor& as_built, const Sensor& sensor, const Exposures& exposures,
                const ScanOptions& options) {
  validate(scene, exposures);
  require_same_images(as_built, sensor);
  check_engine(as_built, options.engine);
  check_engine(sensor, options.engine);
  if (options.engine == Engine::kGeometric && options.keep_images) {
    throw std::invalid_argument("keep_images: the geometric engine makes no images");
  }
  if (options.keep_rejected && sensor.triangulation.fusion != Fusion::kNone) {
    throw std::invalid_argument("keep_rejected: points of several cameras are fused");
  }
  ScanResult result;
  OrderedProfiles ordered(exposures.count * points_per_exposure(sensor, options.engine));
  if (options.engine == Engine::kGeometric) {
    const auto workers = run_workers<GeometricWorker>(
        exposures.count, options.threads,
        [&] { return std::make_unique<GeometricWorker>(as_built, sensor, !scene.lights().empty()); },
        [&](GeometricWorker& worker, std::size_t e) {
          Profiles profiles = ordered.acquire();
          worker.run(scene, exposures, e, profiles);
          ordered.submit(e, std::move(profiles));
        });
    result.seconds = sum_seconds(workers);
  } else {
    const RenderPlan plan(render_settings(as_built));
    const Detector& detector = *as_built.image_sensor;
    const std::size_t stride = options.keep_images ? sensor.cameras.size() * common_size(sensor).pixels() : 0;
    std::unique_ptr<RenderPlan> background;
    if (sensor.laser_off_frame) {
      background = std::make_unique<RenderPlan>(render_settings(as_built, false));
      result.background.resize(exposures.count * stride);
    }
    result.images.resize(exposures.count * stride);
    const auto kept = [&](std::size_t e) {
      RayTracedWorker::Kept to;
      if (!result.images.empty()) to.lit = &result.images[e * stride];
      if (!result.background.empty()) to.background = &result.background[e * stride];
      return to;
    };
    const auto workers = run_workers<RayTracedWorker>(
        exposures.count, options.threads,
        [&] {
          return std::make_unique<RayTracedWorker>(sensor, plan, background.get(), detector,
                                                   options.keep_rejected);
        },
        [&](RayTracedWorker& worker, std::size_t e) {
          Profiles profiles = ordered.acquire();
          worker.run(scene, exposures, e, kept(e), profiles);
          ordered.submit(e, std::move(profiles));
        });
    result.seconds = sum_seconds(workers);
  }
  result.profiles = ordered.take();
  return result;
}

LargeVector<std::uint16_t> render_images(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                         bool laser_on, unsigned threads) {
  validate(scene, exposures);
  const ImageSize size = common_size(sensor);
  const std::size_t cameras = sensor.cameras.size();
  const RenderPlan plan(render_settings(sensor, laser_on));
  const Detector& detector = *sensor.image_sensor;
  LargeVector<std::uint16_t> images(exposures.count * cameras * size.pixels());
  run_workers<ImageWorker>(
      exposures.count, threads, [&] { return std::make_unique<ImageWorker>(plan, detector); },
      [&](ImageWorker& worker, std::size_t e) {
        worker.render(scene, exposures, e);
        for (std::size_t c = 0; c < cameras; ++c) {
          worker.expose(exposures, e, c,
                        {&images[(e * cameras + c) * size.pixels()], size.width, size.height, size.width});
        }
      });
  return images;
}

std::vector<float> expected_electrons(const Scene& scene, const Sensor& sensor, const Exposures& exposures,
                                      unsigned threads) {
  validate(scene, exposures);
  const ImageSize size = common_size(sensor);
  const std::size_t cameras = sensor.cameras.size();
  std::vector<float> images(exposures.count * cameras * size.pixels(), 0.0f);
  const RenderPlan plan(render_settings(sensor));
  run_workers<RenderBuffers>(
      exposures.count, threads, [] { return std::make_unique<RenderBuffers>(); },
      [&](RenderBuffers& buffers, std::size_t e) {
        std::vector<SparseImage> light;
        render_light(plan, scene, exposures, e, buffers, light);
        for (std::size_t c = 0; c < cameras; ++c) {
          float* image = &images[(e * cameras + c) * size.pixels()];
          for (std::size_t i = 0; i < light[c].pixels.size(); ++i)
            image[light[c].pixels[i]] = light[c].electrons[i];
        }
      });
  return images;
}

}  // namespace sensor_rt
