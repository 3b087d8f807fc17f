#include "sensor_rt/render/image_renderer.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include "sensor_rt/render/integrator/lamp_filler.h"
#include "sensor_rt/render/integrator/pixel_tracer.h"
#include "sensor_rt/render/integrator/reflected_lamps.h"
#include "sensor_rt/render/photons/light_tracer.h"
#include "sensor_rt/render/pixels/block_grid.h"
#include "sensor_rt/render/pixels/filled_pixels.h"
#include "sensor_rt/render/reference/path_tracer.h"

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

/// Sets the poses of the exposure. Returns true when rows are exposed at different times.
bool set_poses(const RenderPlan& plan, const Scene& scene, const Exposures& exposures, std::size_t exposure,
               PoseTrack& track) {
  const Rigid3& sensor_from_reference = plan.sensor_from_reference;
  // In units of the duration of the poses: a background frame follows the one with the laser on.
  const double start = plan.settings.laser_on ? 0.0 : 1.0;
  const auto set = [&](std::vector<double> fractions) {
    for (double& fraction : fractions) fraction += start;
    track.set(scene, exposures, exposure, fractions, sensor_from_reference);
  };
  if (is_still(exposures, exposure)) {
    track.set(scene, exposures, exposure, {0.5}, sensor_from_reference);
    return false;
  }
  if (!(plan.settings.row_readout > 0.0)) {
    set(instants_of_exposure(plan.pattern.size()));
    return false;
  }
  set({0.0, 1.0});
  std::vector<std::size_t> shapes(scene.shapes().size());
  std::iota(shapes.begin(), shapes.end(), 0);
  set(closely_spaced(max_motion_px(plan.settings.model, track, shapes), plan.pattern.size()));
  return true;
}

/// Adds electrons, row-major, to an image. Overwrites `dense`.
void add_dense(std::vector<float>& dense, SparseImage& image) {
  constexpr float kFaint = 1e-3f;  // electrons: fainter pixels are omitted
  for (std::size_t i = 0; i < image.pixels.size(); ++i) {
    image.electrons[i] += dense[image.pixels[i]];
    dense[image.pixels[i]] = 0.0f;
  }
  for (std::size_t pixel = 0; pixel < dense.size(); ++pixel) {
    if (dense[pixel] < kFaint) continue;
    image.pixels.push_back(static_cast<std::uint32_t>(pixel));
    image.electrons.push_back(dense[pixel]);
  }
}

/// Marks the pixels that can receive laser light, per camera.
void find_lit(const RenderPlan& plan, const SceneQuery& query, LitPixelMarker::Buffers& buffers,
              std::vector<PixelMask>& lit) {
  const bool all = !plan.settings.lit_pixels || plan.settings.ground_truth;
  lit.resize(plan.settings.model.cameras.size());
  for (std::size_t c = 0; c < lit.size(); ++c) {
    const Camera& camera = plan.settings.model.cameras[c];
    lit[c].resize(camera.width_px, camera.height_px);
    if (all) lit[c].mark_all();
  }
  if (!all && plan.settings.laser_on) LitPixelMarker(plan, query, buffers).mark(lit);
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

/// One exposure as one camera sees it.
class CameraImage {
 public:
  CameraImage(const RenderPlan& plan, const ExposureViews& views, RowViews* rows, std::size_t number,
              std::int64_t frame, double duration, SparseImage& image)
      : plan_(plan),
        views_(views),
        rows_(rows),
        number_(number),
        frame_(frame),
        duration_(duration),
        camera_(plan.settings.model.cameras[number]),
        image_(image) {
    image.pixels.clear();
    image.electrons.clear();
  }

  void trace_paths(const PixelMask& pixels);
  void trace_direct(PixelMask& lit, PixelCover::Corners& corners, bool mirrors, std::vector<float>& dense);
  void add_reflected(SplatImage& reflected, std::vector<float>& dense);

 private:
  void add(int column, int row, double electrons_per_second) {
    image_.pixels.push_back(static_cast<std::uint32_t>(row * camera_.width_px + column));
    image_.electrons.push_back(static_cast<float>(electrons_per_second * duration_));
  }
  void add_lit(int column, int row, double electrons_per_second) {
    if (electrons_per_second > 0.0) add(column, row, electrons_per_second);
  }
  /// Visits the pixels in the order that suits their views.
  template <typename Visit>
  void visit_pixels(const PixelMask& pixels, const Visit& visit) const {
    if (rows_ != nullptr) {
      pixels.for_each_by_row(visit);
    } else {
      pixels.for_each(visit);
    }
  }
  PixelMask find_mirrors(const PixelTracer& tracer) const;
  void trace_lit(const PixelTracer& tracer, const PathTracer* mirrored, const PixelMask& mirrors,
                 const PixelMask& lit, PixelCover::Corners& corners);
  void add_ambient(const PixelTracer& tracer, const PixelMask& lit, double irradiance);
  void add_lamps(const PixelTracer& tracer, const PathTracer* mirrored, const PixelMask& mirrors,
                 std::vector<float>& dense);

  const RenderPlan& plan_;
  const ExposureViews& views_;
  RowViews* rows_;
  std::size_t number_;
  std::int64_t frame_;
  double duration_;
  const Camera& camera_;
  SparseImage& image_;
};

/// Ground truth.
void CameraImage::trace_paths(const PixelMask& pixels) {
  const PathTracer paths(plan_, PathTracer::Mode::kAllBounces, views_, rows_, number_, frame_);
  visit_pixels(pixels, [&](int column, int row) { add_lit(column, row, paths.trace(column, row)); });
}

/// Light of laser, surroundings and lamps on directly visible surfaces, and all light by way of mirrors when
/// `mirrors`. Adds the pixels that show mirrors to `lit`.
void CameraImage::trace_direct(PixelMask& lit, PixelCover::Corners& corners, bool mirrors,
                               std::vector<float>& dense) {
  const PixelTracer tracer(plan_, views_, rows_, number_);
  std::optional<PathTracer> paths;
  PixelMask mirrored;
  if (mirrors) {
    paths.emplace(plan_, PathTracer::Mode::kMirrorsOnly, views_, nullptr, number_, frame_);
    mirrored = find_mirrors(tracer);
    mirrored.for_each([&](int column, int row) { lit.mark(column, column, row, row); });
  }
  trace_lit(tracer, paths ? &*paths : nullptr, mirrored, lit, corners);
  const double ambient = plan_.settings.model.ambient_irradiance;
  if (ambient > 0.0) add_ambient(tracer, lit, ambient);
  if (!views_.query.scene().lights().empty()) add_lamps(tracer, paths ? &*paths : nullptr, mirrored, dense);
}

void CameraImage::trace_lit(const PixelTracer& tracer, const PathTracer* mirrored, const PixelMask& mirrors,
                            const PixelMask& lit, PixelCover::Corners& corners) {
  // Accelerators: the patch that fills a pixel, and the closed form for planar patches.
  const RenderSettings& settings = plan_.settings;
  std::optional<PixelCover> cover;
  if (settings.pixel_cover && rows_ == nullptr) {
    cover.emplace(plan_, views_.query, number_, lit, corners);
    if (!cover->applies()) cover.reset();
  }
  std::optional<FilledPixels> filled;
  if (cover && settings.closed_form && FilledPixels::applies(plan_, number_)) {
    filled.emplace(plan_, views_, number_);
  }
  const auto sample = [&](int column, int row, const Patch& patch) {
    add_lit(column, row, tracer.trace(column, row, patch));
  };
  const auto add_filled = [&](int column, int row, double electrons_per_second, const Patch* edge) {
    const double beyond = edge != nullptr ? tracer.beyond_first_face(column, row, *edge) : 0.0;
    add_lit(column, row, electrons_per_second + beyond);
  };
  visit_pixels(lit, [&](int column, int row) {
    const Patch patch = cover ? cover->patch(column, row) : Patch{};
    if (mirrored != nullptr && mirrors.test(column, row)) {
      add_lit(column, row, mirrored->trace(column, row));
    } else if (!filled || !filled->add(column, row, patch, add_filled, sample)) {
      sample(column, row, patch);
    }
  });
  if (filled) filled->finish(add_filled, sample);
}

/// Returns the pixels that may show mirrors: a mirror at a corner marks the adjacent blocks.
PixelMask CameraImage::find_mirrors(const PixelTracer& tracer) const {
  const BlockGrid<std::int32_t> shapes(camera_.width_px, camera_.height_px,
                                       [&](int column, int row) { return tracer.shape_at(column, row); });
  PixelMask mirrors;
  mirrors.resize(camera_.width_px, camera_.height_px);
  for (int j = 0; j < shapes.rows(); ++j) {
    for (int i = 0; i < shapes.columns(); ++i) {
      if (shapes.at(i, j) < 0 || !views_.brdf(shapes.at(i, j)).is_specular()) continue;
      mirrors.mark((i - 1) * kBlock, (i + 1) * kBlock, (j - 1) * kBlock, (j + 1) * kBlock);
    }
  }
  return mirrors;
}

/// Adds ambient light to the pixels outside `lit` that see a surface.
///
/// Ambient light is uniform and has no occlusion here (path tracing has it), so that the image is constant
/// wherever one reflectance fills the view. Blocks whose corners agree are filled; in all others every pixel
/// gets a ray through its centre, at mid-exposure. A detail within one block is missed.
void CameraImage::add_ambient(const PixelTracer& tracer, const PixelMask& lit, double irradiance) {
  const auto trace = [&](int column, int row) { return tracer.reflectance(column, row); };
  const BlockGrid<double> corners(camera_.width_px, camera_.height_px, trace);
  for (int row = 0; row < camera_.height_px; ++row) {
    for (int column = 0; column < camera_.width_px; ++column) {
      if (lit.test(column, row)) continue;
      const int i = column / kBlock;
      const int j = row / kBlock;
      const double corner = corners.at(i, j);
      const bool is_uniform = corner == corners.at(i + 1, j) && corner == corners.at(i, j + 1) &&
                              corner == corners.at(i + 1, j + 1);
      const double reflectance = is_uniform ? corner : trace(column, row);
      if (reflectance > 0.0) add(column, row, tracer.electrons(column, row, reflectance * irradiance));
    }
  }
}

void CameraImage::add_lamps(const PixelTracer& tracer, const PathTracer* mirrored, const PixelMask& mirrors,
                            std::vector<float>& dense) {
  const auto width = static_cast<std::size_t>(camera_.width_px);
  dense.resize(width * static_cast<std::size_t>(camera_.height_px));
  std::optional<ReflectedLamps> reflected;
  if (plan_.settings.bounces > 0) reflected.emplace(plan_, views_, number_, frame_, tracer);
  fill_lamps(tracer, reflected ? &*reflected : nullptr, camera_.width_px, camera_.height_px, dense.data());
  for (float& electrons : dense) electrons *= static_cast<float>(duration_);
  if (mirrored != nullptr) {  // paths via mirrors include the light of lamps
    mirrors.for_each([&](int column, int row) {
      dense[static_cast<std::size_t>(row) * width + static_cast<std::size_t>(column)] = 0.0f;
    });
  }
  add_dense(dense, image_);
}

void CameraImage::add_reflected(SplatImage& reflected, std::vector<float>& dense) {
  const ImageView<const float> light = reflected.resolve();
  const auto width = static_cast<std::size_t>(light.width);
  dense.resize(width * static_cast<std::size_t>(light.height));
  for (int y = 0; y < light.height; ++y) {
    float* out = &dense[static_cast<std::size_t>(y) * width];
    for (int x = 0; x < light.width; ++x) out[x] = static_cast<float>(duration_) * light.at(y, x);
  }
  add_dense(dense, image_);
}

}  // namespace

void render_light(const RenderPlan& plan, const Scene& scene, const Exposures& exposures,
                  std::size_t exposure, RenderBuffers& buffers, std::vector<SparseImage>& images) {
  const RenderSettings& settings = plan.settings;
  const bool is_rolling = set_poses(plan, scene, exposures, exposure, buffers.track);
  const SceneQuery query(scene, buffers.track);
  buffers.views.set(plan, query);
  std::optional<RowViews> rows;
  if (is_rolling) rows.emplace(plan, scene, exposures, exposure, buffers.rows);
  find_lit(plan, query, buffers.marker, buffers.lit);
  const bool has_mirrors = std::any_of(scene.shapes().begin(), scene.shapes().end(),
                                       [](const Shape& shape) { return shape.surface->is_specular(); });
  const std::int64_t frame = frame_number(exposures, exposure, settings.laser_on);
  // Paths from the pixels find all laser light except that which a mirror reflects first.
  const bool photons = settings.laser_on && settings.bounces > 0 && (has_mirrors || !settings.ground_truth);
  if (photons) trace_photons(plan, buffers.views, frame, buffers.reflected);
  images.resize(settings.model.cameras.size());
  for (std::size_t c = 0; c < images.size(); ++c) {
    CameraImage image(plan, buffers.views, rows ? &*rows : nullptr, c, frame, exposures.duration[exposure],
                      images[c]);
    if (settings.ground_truth) {
      image.trace_paths(buffers.lit[c]);
    } else {
      image.trace_direct(buffers.lit[c], buffers.corners, has_mirrors && settings.bounces > 0, buffers.dense);
    }
    if (!plan.lens_blurs.empty()) plan.lens_blurs[c].apply(images[c], buffers.blur);
    if (photons) image.add_reflected(buffers.reflected[c], buffers.dense);
  }
}

}  // namespace sensor_rt
