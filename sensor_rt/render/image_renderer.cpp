#include "sensor_rt/render/image_renderer.h"

#include <algorithm>

namespace sensor_rt {
namespace {

/// True when nothing moves relative to anything during the exposure.
bool is_still(const Exposures& exposures, std::size_t exposure) {
  const auto constant = [&](const Rigid3* poses) {
    return std::all_of(poses, poses + exposures.samples,
                       [&](const Rigid3& pose) { return pose == poses[0]; });
  };
  if (!constant(exposures.sensor_poses(exposure))) return false;
  for (std::size_t body = 0; body < exposures.bodies; ++body) {
    if (!constant(exposures.body_poses(exposure, body))) return false;
  }
  return true;
}

}  // namespace

ImageRenderer::ImageRenderer(const RenderPlan& plan)
    : plan_(plan),
      fractions_(instants_of_exposure(plan.pattern.size())),
      middle_{0.5},
      marker_(plan),
      tracer_(plan),
      masks_(plan.settings.model.cameras.size()) {
  for (std::size_t c = 0; c < masks_.size(); ++c) {
    const Camera& camera = plan.settings.model.cameras[c];
    masks_[c].resize(camera.width_px, camera.height_px);
  }
}

void ImageRenderer::render(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                           std::vector<SparseImage>& images) {
  track_.set(scene, exposures, exposure, is_still(exposures, exposure) ? middle_ : fractions_);
  find_pixels(scene);
  tracer_.set(scene, track_);
  images.resize(masks_.size());
  for (std::size_t c = 0; c < masks_.size(); ++c) trace_camera(c, exposures.duration[exposure], images[c]);
}

void ImageRenderer::find_pixels(const Scene& scene) {
  for (PixelMask& mask : masks_) {
    if (plan_.settings.whole_image) {
      mask.mark_all();
    } else {
      mask.clear();
    }
  }
  if (!plan_.settings.whole_image) marker_.mark(scene, track_, masks_);
}

void ImageRenderer::trace_camera(std::size_t number, double duration, SparseImage& image) {
  const Camera& camera = plan_.settings.model.cameras[number];
  image.pixels.clear();
  image.electrons.clear();
  const auto add = [&](int column, int row, double electrons_per_second) {
    image.pixels.push_back(static_cast<std::uint32_t>(row * camera.width_px + column));
    image.electrons.push_back(static_cast<float>(electrons_per_second * duration));
  };
  tracer_.select_camera(number);
  masks_[number].for_each([&](int column, int row) {
    const double electrons_per_second = tracer_.trace(column, row);
    if (electrons_per_second > 0.0) add(column, row, electrons_per_second);
  });
  const double ambient = plan_.settings.model.ambient_irradiance;
  if (ambient > 0.0) {
    ambient_.fill(tracer_, camera.width_px, camera.height_px, masks_[number], ambient, add);
  }
}

}  // namespace sensor_rt
