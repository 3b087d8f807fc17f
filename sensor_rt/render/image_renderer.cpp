#include "sensor_rt/render/image_renderer.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace sensor_rt {
namespace {

/// Returns true when there is no relative motion during the exposure.
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

/// Returns instants of a long exposure between which all motion is below a pixel.
std::vector<double> closely_spaced(double motion_px, std::size_t least) {
  constexpr double kCapacity = 1024.0;
  std::vector<double> fractions = {0.0};
  const auto steps =
      static_cast<std::size_t>(std::clamp(std::ceil(motion_px), static_cast<double>(least), kCapacity));
  for (std::size_t i = 1; i <= steps; ++i) {
    fractions.push_back(static_cast<double>(i) / static_cast<double>(steps));
  }
  return fractions;
}

}  // namespace

ImageRenderer::ImageRenderer(const RenderPlan& plan)
    : plan_(plan),
      start_(plan.settings.laser_on ? 0.0 : 1.0),
      fractions_(instants_of_exposure(plan.pattern.size())),
      middle_{0.5},
      rows_(plan),
      marker_(plan),
      cover_(plan),
      filled_(plan),
      tracer_(plan),
      reflected_lamps_(plan),
      path_tracer_(plan, PathTracer::Mode::kAllBounces),
      mirror_tracer_(plan, PathTracer::Mode::kMirrorsOnly),
      light_tracer_(plan),
      reflected_(plan.settings.bounces > 0 ? plan.settings.model.cameras.size() : 0),
      masks_(plan.settings.model.cameras.size()) {
  for (double& fraction : fractions_) fraction += start_;
  for (std::size_t c = 0; c < masks_.size(); ++c) {
    const Camera& camera = plan.settings.model.cameras[c];
    masks_[c].resize(camera.width_px, camera.height_px);
    if (!reflected_.empty()) reflected_[c].resize(camera.width_px, camera.height_px);
  }
}

void ImageRenderer::render(const Scene& scene, const Exposures& exposures, std::size_t exposure,
                           std::vector<SparseImage>& images) {
  is_rolling_ = place(scene, exposures, exposure);
  RowViews* rows = is_rolling_ ? &rows_ : nullptr;
  has_mirrors_ = std::any_of(scene.shapes().begin(), scene.shapes().end(),
                             [](const Shape& shape) { return shape.surface->is_specular(); });
  find_pixels(scene);
  views_.set(plan_, scene, track_);
  tracer_.set(views_, rows);
  cover_.set(scene, track_);
  filled_.set(views_);
  const std::int64_t frame = frame_number(exposures, exposure, plan_.settings.laser_on);
  path_tracer_.set(views_, frame, rows);
  mirror_tracer_.set(views_, frame, nullptr);
  reflected_lamps_.set(views_, frame);
  if (follows_photons()) {
    for (SplatImage& image : reflected_) image.clear();
    light_tracer_.trace(views_, frame, plan_.settings.ground_truth, reflected_);
  }
  images.resize(masks_.size());
  for (std::size_t c = 0; c < masks_.size(); ++c) trace_camera(c, exposures.duration[exposure], images[c]);
}

/// Sets the poses of the exposure. Returns true when rows are exposed at different times.
bool ImageRenderer::place(const Scene& scene, const Exposures& exposures, std::size_t exposure) {
  const Rigid3& sensor_from_reference = plan_.sensor_from_reference;
  const bool still = is_still(exposures, exposure);
  const bool rolling = !still && plan_.settings.row_readout > 0.0;
  if (!rolling) {
    track_.set(scene, exposures, exposure, still ? middle_ : fractions_, sensor_from_reference);
    return false;
  }
  track_.set(scene, exposures, exposure, {start_, start_ + 1.0}, sensor_from_reference);
  std::vector<std::size_t> shapes(scene.shapes().size());
  std::iota(shapes.begin(), shapes.end(), 0);
  const double motion_px = max_motion_px(plan_.settings.model, track_, shapes);
  std::vector<double> fractions = closely_spaced(motion_px, plan_.pattern.size());
  for (double& fraction : fractions) fraction += start_;
  track_.set(scene, exposures, exposure, fractions, sensor_from_reference);
  rows_.set(scene, exposures, exposure);
  return true;
}

void ImageRenderer::find_pixels(const Scene& scene) {
  const bool all = plan_.settings.whole_image || plan_.settings.ground_truth;
  for (PixelMask& mask : masks_) {
    if (all) {
      mask.mark_all();
    } else {
      mask.clear();
    }
  }
  if (!all && plan_.settings.laser_on) marker_.mark(scene, track_, masks_);
}

void ImageRenderer::trace_camera(std::size_t number, double duration, SparseImage& image) {
  image.pixels.clear();
  image.electrons.clear();
  trace_marked(number, duration, image);
  if (!views_.scene->lights().empty() && !plan_.settings.ground_truth) add_lamps(number, duration, image);
  if (follows_photons()) {
    add_reflected(number, duration, image);
  }
}

void ImageRenderer::trace_marked(std::size_t number, double duration, SparseImage& image) {
  const Camera& camera = plan_.settings.model.cameras[number];
  const auto add = [&](int column, int row, double electrons_per_second) {
    image.pixels.push_back(static_cast<std::uint32_t>(row * camera.width_px + column));
    image.electrons.push_back(static_cast<float>(electrons_per_second * duration));
  };
  if (plan_.settings.ground_truth) {
    path_tracer_.select_camera(number);
    masks_[number].for_each([&](int column, int row) {
      const double electrons_per_second = path_tracer_.trace(column, row);
      if (electrons_per_second > 0.0) add(column, row, electrons_per_second);
    });
    return;
  }
  tracer_.select_camera(number);
  const bool mirrors = has_mirrors_ && plan_.settings.bounces > 0;
  if (mirrors) {
    mirror_tracer_.select_camera(number);
    mark_mirrors(number);
  }
  const bool covers = !plan_.settings.whole_image && !is_rolling_ && cover_.select_camera(number);
  const bool fills = covers && plan_.settings.closed_form && filled_.select_camera(number);
  const auto add_lit = [&](int column, int row, double electrons_per_second) {
    if (electrons_per_second > 0.0) add(column, row, electrons_per_second);
  };
  const auto sample = [&](int column, int row, const Patch& patch) {
    add_lit(column, row, tracer_.trace(column, row, patch));
  };
  const auto add_filled = [&](int column, int row, double electrons_per_second, const Patch* edge) {
    const double beyond = edge != nullptr ? tracer_.beyond_first_face(column, row, *edge) : 0.0;
    add_lit(column, row, electrons_per_second + beyond);
  };
  masks_[number].for_each([&](int column, int row) {
    const Patch patch = covers ? cover_.patch(column, row, masks_[number]) : Patch{};
    if (mirrors && mirror_mask_.test(column, row)) {
      add_lit(column, row, mirror_tracer_.trace(column, row));
    } else if (!fills || !filled_.add(column, row, patch, add_filled, sample)) {
      sample(column, row, patch);
    }
  });
  if (fills) filled_.finish(add_filled, sample);
  const double ambient = plan_.settings.model.ambient_irradiance;
  if (ambient > 0.0) {
    ambient_.fill(tracer_, camera.width_px, camera.height_px, masks_[number], ambient, add);
  }
}

void ImageRenderer::mark_mirrors(std::size_t number) {
  // One ray at each corner of a grid; a mirror hit at a corner marks the adjacent blocks.
  constexpr int kBlock = 8;
  const Camera& camera = plan_.settings.model.cameras[number];
  mirror_mask_.resize(camera.width_px, camera.height_px);
  mirror_mask_.clear();
  for (int row = 0; row < camera.height_px + kBlock; row += kBlock) {
    for (int column = 0; column < camera.width_px + kBlock; column += kBlock) {
      const std::int32_t shape =
          tracer_.shape_at(std::min(column, camera.width_px - 1), std::min(row, camera.height_px - 1));
      if (shape < 0 || !views_.brdf(shape).is_specular()) continue;
      mirror_mask_.mark(column - kBlock, column + kBlock, row - kBlock, row + kBlock);
    }
  }
  mirror_mask_.for_each([&](int column, int row) { masks_[number].mark(column, column, row, row); });
}

void ImageRenderer::add_reflected(std::size_t number, double duration, SparseImage& image) {
  const ImageView<const float> reflected = reflected_[number].resolve();
  dense_.resize(static_cast<std::size_t>(reflected.width) * static_cast<std::size_t>(reflected.height));
  const auto seconds = static_cast<float>(duration);
  for (int y = 0; y < reflected.height; ++y) {
    float* out = &dense_[static_cast<std::size_t>(y) * static_cast<std::size_t>(reflected.width)];
    for (int x = 0; x < reflected.width; ++x) out[x] = seconds * reflected.at(y, x);
  }
  add_dense(image);
}

void ImageRenderer::add_lamps(std::size_t number, double duration, SparseImage& image) {
  const Camera& camera = plan_.settings.model.cameras[number];
  const bool bounces = plan_.settings.bounces > 0;
  dense_.resize(static_cast<std::size_t>(camera.width_px) * static_cast<std::size_t>(camera.height_px));
  if (bounces) reflected_lamps_.select_camera(number, tracer_);
  lamps_.fill(tracer_, bounces ? &reflected_lamps_ : nullptr, camera.width_px, camera.height_px,
              dense_.data());
  for (float& electrons : dense_) electrons *= static_cast<float>(duration);
  // Paths via mirrors include the light of lamps.
  if (bounces && has_mirrors_) {
    mirror_mask_.for_each([&](int column, int row) {
      dense_[static_cast<std::size_t>(row) * static_cast<std::size_t>(camera.width_px) +
             static_cast<std::size_t>(column)] = 0.0f;
    });
  }
  add_dense(image);
}

/// Adds dense_ to the image and clears it.
void ImageRenderer::add_dense(SparseImage& image) {
  // Pixels below a thousandth of an electron are omitted.
  constexpr float kFaint = 1e-3f;
  for (std::size_t i = 0; i < image.pixels.size(); ++i) {
    image.electrons[i] += dense_[image.pixels[i]];
    dense_[image.pixels[i]] = 0.0f;
  }
  for (std::size_t pixel = 0; pixel < dense_.size(); ++pixel) {
    if (dense_[pixel] < kFaint) continue;
    image.pixels.push_back(static_cast<std::uint32_t>(pixel));
    image.electrons.push_back(dense_[pixel]);
  }
}

}  // namespace sensor_rt
