#include "sensor_rt/render/image_renderer.h"

#include <algorithm>
#include <optional>

#include "sensor_rt/render/lamps/block_grid.h"
#include "sensor_rt/render/lamps/lamp_filler.h"
#include "sensor_rt/render/paths/path_tracer.h"
#include "sensor_rt/render/photons/light_tracer.h"
#include "sensor_rt/render/stripe/stripe_raster.h"
#include "sensor_rt/scene/bsdf/subsurface.h"

namespace sensor_rt {
namespace {

/// Sets the poses for light other than the stripe. Returns true when rows are exposed at different times.
bool set_poses(const RenderPlan& plan, const Scene& scene, const Exposures& exposures, std::size_t exposure,
               PoseTrack& track) {
  const bool still = exposures.is_still(exposure);
  std::vector<double> fractions =
      still ? std::vector<double>{0.5} : instants_of_exposure(plan.pattern.size());
  // In units of the duration of the poses: a background frame follows the one with the laser on.
  if (!plan.settings.laser_on && !still) {
    for (double& fraction : fractions) fraction += 1.0;
  }
  track.set(scene, exposures, exposure, fractions, plan.sensor_from_reference);
  return !still && plan.settings.row_readout > 0.0;
}

/// Appends the light of the laser on directly visible surfaces to the images of all cameras.
void draw_stripe(const RenderPlan& plan, const Scene& scene, const Exposures& exposures, std::size_t exposure,
                 RenderBuffers& buffers, std::vector<SparseImage>& images) {
  buffers.samples.set(plan, scene, exposures, exposure);
  buffers.mesh.set(plan, scene, buffers.samples);
  if (buffers.mesh.is_empty()) return;
  const std::size_t cameras = plan.stripe_cameras.size();
  buffers.stripe.resize(cameras);
  std::vector<Speckle> speckle;
  std::vector<StripeRaster> rasters;
  speckle.reserve(cameras);
  for (std::size_t c = 0; c < cameras; ++c) {
    const Camera& optics = plan.stripe_cameras[c].optics;
    speckle.emplace_back(plan, scene, buffers.samples.track(), c);
    buffers.stripe[c].resize(optics.width_px, optics.height_px, speckle[c].enabled());
    rasters.emplace_back(plan, buffers.mesh, buffers.samples, c,
                         speckle[c].enabled() ? &speckle[c] : nullptr);
  }
  const int parts = buffers.mesh.has_subsurface() ? Subsurface::kParts : 0;
  for (std::size_t sample = 0; sample < buffers.samples.size(); ++sample) {
    for (int part = LaserMesh::kAtSurface; part < parts; ++part) {
      buffers.mesh.build(sample, part);
      for (std::size_t c = 0; c < cameras; ++c) {
        buffers.samples.row_shares(plan.stripe_cameras[c].optics, sample, buffers.row_shares);
        rasters[c].draw(sample, buffers.row_shares, buffers.stripe[c]);
      }
    }
  }
  const auto duration = static_cast<float>(exposures.duration[exposure]);
  for (std::size_t c = 0; c < cameras; ++c) {
    const StripeCamera& camera = plan.stripe_cameras[c];
    if (camera.blur) {
      camera.blur->apply(buffers.stripe[c], duration, buffers.blur, images[c]);
    } else {
      buffers.stripe[c].move_to(images[c], camera.optics.width_px, camera.optics.height_px, duration);
    }
  }
}

/// Traces laser light that is reflected between surfaces to one image per camera.
void trace_photons(const RenderPlan& plan, const ExposureViews& views, std::int64_t frame,
                   std::vector<SplatImage>& images) {
  images.resize(plan.settings.model.cameras.size());
  for (std::size_t c = 0; c < images.size(); ++c) {
    const Camera& camera = plan.settings.model.cameras[c];
    images[c].reset(camera.width_px, camera.height_px);
  }
  LightTracer(plan, views, frame, plan.settings.ground_truth).trace(images);
}

/// Light other than the stripe in one exposure as one camera sees it: electrons per second, row by row.
class DenseLight {
 public:
  DenseLight(const RenderPlan& plan, const ExposureViews& views, RowViews* rows, std::size_t number,
             std::int64_t frame, std::vector<float>& light)
      : plan_(plan),
        views_(views),
        rows_(rows),
        number_(number),
        frame_(frame),
        camera_(plan.settings.model.cameras[number]),
        light_(light) {
    light.assign(static_cast<std::size_t>(camera_.width_px) * static_cast<std::size_t>(camera_.height_px),
                 0.0f);
  }

  /// All light, as ground truth.
  void add_paths() {
    const PathTracer paths(plan_, PathTracer::Mode::kAllBounces, views_, rows_, number_, frame_);
    for (int row = 0; row < camera_.height_px; ++row) {
      for (int column = 0; column < camera_.width_px; ++column)
        at(column, row) = to_float(paths.trace(column, row));
    }
  }

  /// Light of surroundings and lamps, and all light by way of mirrors when `has_mirrors`.
  void add_surroundings(bool has_mirrors) {
    const CentreTracer tracer(plan_, views_, rows_, number_);
    if (!views_.query.scene().lights().empty()) add_lamps(tracer);
    const double ambient = plan_.settings.model.ambient_irradiance;
    if (ambient > 0.0) add_ambient(tracer, ambient);
    if (has_mirrors) trace_mirrors(tracer);
  }

  void add_reflected(SplatImage& reflected) {
    const ImageView<const float> splats = reflected.resolve();
    for (int row = 0; row < splats.height; ++row) {
      for (int column = 0; column < splats.width; ++column) at(column, row) += splats.at(row, column);
    }
  }

 private:
  static float to_float(double electrons) { return static_cast<float>(std::max(electrons, 0.0)); }
  float& at(int column, int row) {
    return light_[static_cast<std::size_t>(row) * static_cast<std::size_t>(camera_.width_px) +
                  static_cast<std::size_t>(column)];
  }
  void add_ambient(const CentreTracer& tracer, double irradiance);
  void add_lamps(const CentreTracer& tracer);
  void trace_mirrors(const CentreTracer& tracer);

  const RenderPlan& plan_;
  const ExposureViews& views_;
  RowViews* rows_;
  std::size_t number_;
  std::int64_t frame_;
  const Camera& camera_;
  std::vector<float>& light_;
};

/// Ambient light is uniform and has no occlusion here (path tracing has it), so that the image is constant
/// wherever one reflectance fills the view. Blocks whose corners agree are filled; in all others every pixel
/// gets a ray through its centre, at mid-exposure. A detail within one block is missed.
void DenseLight::add_ambient(const CentreTracer& tracer, double irradiance) {
  const auto trace = [&](int column, int row) { return tracer.reflectance(column, row); };
  const BlockGrid<double> corners(camera_.width_px, camera_.height_px, trace);
  for (int row = 0; row < camera_.height_px; ++row) {
    for (int column = 0; column < camera_.width_px; ++column) {
      const int i = column / kBlock;
      const int j = row / kBlock;
      const double corner = corners.at(i, j);
      const bool is_uniform = corner == corners.at(i + 1, j) && corner == corners.at(i, j + 1) &&
                              corner == corners.at(i + 1, j + 1);
      const double reflectance = is_uniform ? corner : trace(column, row);
      if (reflectance > 0.0)
        at(column, row) += to_float(tracer.electrons(column, row, reflectance * irradiance));
    }
  }
}

void DenseLight::add_lamps(const CentreTracer& tracer) {
  std::optional<ReflectedLamps> reflected;
  if (plan_.settings.bounces > 0) reflected.emplace(plan_, views_, number_, frame_, tracer);
  fill_lamps(tracer, reflected ? &*reflected : nullptr, camera_.width_px, camera_.height_px, light_.data());
}

/// Replaces the light of surroundings and lamps where the image may show a mirror by that of paths, which
/// contain both. A mirror at the corner of a block marks the adjacent blocks.
void DenseLight::trace_mirrors(const CentreTracer& tracer) {
  const PathTracer paths(plan_, PathTracer::Mode::kMirrorsOnly, views_, nullptr, number_, frame_);
  const BlockGrid<std::int32_t> shapes(camera_.width_px, camera_.height_px,
                                       [&](int column, int row) { return tracer.shape_at(column, row); });
  const auto is_mirror = [&](int i, int j) {
    const std::int32_t shape = shapes.at(i, j);
    return shape >= 0 && views_.brdf(shape).is_specular();
  };
  for (int row = 0; row < camera_.height_px; ++row) {
    for (int column = 0; column < camera_.width_px; ++column) {
      const int i = column / kBlock;
      const int j = row / kBlock;
      if (is_mirror(i, j) || is_mirror(i + 1, j) || is_mirror(i, j + 1) || is_mirror(i + 1, j + 1)) {
        at(column, row) = to_float(paths.trace(column, row));
      }
    }
  }
}

/// Adds light, electrons per second, to an image. Overwrites `light`.
void add_dense(std::vector<float>& light, double duration, SparseImage& image) {
  for (float& electrons : light) electrons *= static_cast<float>(duration);
  for (std::size_t i = 0; i < image.pixels.size(); ++i) {
    image.electrons[i] += light[image.pixels[i]];
    light[image.pixels[i]] = 0.0f;
  }
  for (std::size_t pixel = 0; pixel < light.size(); ++pixel) {
    image.append(static_cast<std::uint32_t>(pixel), light[pixel]);
  }
}

}  // namespace

void render_light(const RenderPlan& plan, const Scene& scene, const Exposures& exposures,
                  std::size_t exposure, RenderBuffers& buffers, std::vector<SparseImage>& images) {
  const RenderSettings& settings = plan.settings;
  images.resize(settings.model.cameras.size());
  for (SparseImage& image : images) image.clear();
  if (settings.laser_on && !settings.ground_truth) {
    draw_stripe(plan, scene, exposures, exposure, buffers, images);
  }
  const bool has_surroundings = settings.model.ambient_irradiance > 0.0 || !scene.lights().empty();
  if (!settings.ground_truth && settings.bounces == 0 && !has_surroundings) return;
  const bool is_rolling = set_poses(plan, scene, exposures, exposure, buffers.track);
  buffers.views.set(plan, SceneQuery(scene, buffers.track));
  std::optional<RowViews> rows;
  if (is_rolling) rows.emplace(plan, scene, exposures, exposure, buffers.rows);
  const bool has_mirrors = std::any_of(scene.shapes().begin(), scene.shapes().end(),
                                       [](const Shape& shape) { return shape.surface->is_specular(); });
  const std::int64_t frame = frame_number(exposures, exposure, settings.laser_on);
  // Paths from the pixels find all laser light except that which a mirror reflects first.
  const bool photons = settings.laser_on && settings.bounces > 0 && (has_mirrors || !settings.ground_truth);
  if (photons) trace_photons(plan, buffers.views, frame, buffers.reflected);
  for (std::size_t c = 0; c < images.size(); ++c) {
    DenseLight light(plan, buffers.views, rows ? &*rows : nullptr, c, frame, buffers.dense);
    if (settings.ground_truth) {
      light.add_paths();
    } else {
      light.add_surroundings(has_mirrors && settings.bounces > 0);
    }
    if (photons) light.add_reflected(buffers.reflected[c]);
    add_dense(buffers.dense, exposures.duration[exposure], images[c]);
  }
}

}  // namespace sensor_rt
