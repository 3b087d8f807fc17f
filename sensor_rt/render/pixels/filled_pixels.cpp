#include "sensor_rt/render/pixels/filled_pixels.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/render/emitter/sheet_light.h"

namespace sensor_rt {
namespace {

/// Largest deviation of a pose from linear motion, in pixels: it shifts the centre of a stripe.
constexpr double kMaxBend = 3e-4;
/// Distance from the origin of a shape's frame within which kMaxBend holds, m.
constexpr double kMaxDistance = 0.3;
/// Smallest width of a lobe, rad: it is nearly constant over a pixel.
constexpr double kMinLobe = 0.1;

/// Returns the side of face a on which face b lies, 1 along its normal, else -1; 0 when they share no edge.
double rise_of(const Shape& shape, std::uint32_t a, std::uint32_t b) {
  const std::uint32_t* of_a = shape.faces + 3 * std::size_t{a};
  int shared = 0;
  std::uint32_t apex = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    const std::uint32_t vertex = shape.faces[3 * std::size_t{b} + i];
    const bool common = vertex == of_a[0] || vertex == of_a[1] || vertex == of_a[2];
    shared += common ? 1 : 0;
    apex = common ? apex : vertex;
  }
  if (shared != 2) return 0.0;
  const FacePlane& plane = shape.planes[a];
  double height = -plane.offset;
  for (std::size_t k = 0; k < 3; ++k) {
    height += plane.normal[k] * static_cast<double>(shape.vertices[3 * std::size_t{apex} + k]);
  }
  return height > 0.0 ? 1.0 : -1.0;
}

/// Repeats the last lane of an incomplete batch.
void fill_up(FilledPixels::Batch& b) {
  double* const values[] = {
      b.x,        b.y,        b.dx_du,  b.dx_dv,          b.dy_du,          b.dy_dv,          b.normal.x,
      b.normal.y, b.normal.z, b.offset, b.other_normal.x, b.other_normal.y, b.other_normal.z, b.other_offset,
      b.rise};
  for (double* value : values) std::fill(value + b.count, value + kLanes, value[b.count - 1]);
}

bool is_linear(const PoseTrack& track, std::size_t shape, double tolerance) {
  const std::size_t last = track.instants() - 1;
  const Rigid3& from = track.shape_from_reference(shape, 0);
  const Rigid3& to = track.shape_from_reference(shape, last);
  for (std::size_t i = 1; i < last; ++i) {
    const double share = static_cast<double>(i) / static_cast<double>(last);
    const Rigid3& pose = track.shape_from_reference(shape, i);
    const Eigen::Matrix3d rotation_error =
        pose.rotation - (1.0 - share) * from.rotation - share * to.rotation;
    const Eigen::Vector3d translation_error =
        pose.translation - (1.0 - share) * from.translation - share * to.translation;
    if (!(kMaxDistance * rotation_error.norm() + translation_error.norm() <= tolerance)) return false;
  }
  return true;
}

}  // namespace

FilledPixels::FilledPixels(const RenderPlan& plan, const ExposureViews& views, std::size_t camera)
    : plan_(plan), views_(views), rays_(plan, camera) {
  const PoseTrack& track = views.query.track();
  const std::size_t last = track.instants() - 1;
  const auto instants = static_cast<double>(track.instants());
  time_scale_ = last == 0 ? 0.0 : instants / (instants - 1.0);  // the instants are centres of strata
  const std::vector<Shape>& shapes = views.query.scene().shapes();
  for (std::size_t s = 0; s < shapes.size(); ++s) {
    const bool sharp = shapes[s].surface->lobe_width() < kMinLobe;
    const bool planar = shapes[s].kind == ShapeKind::kMesh || shapes[s].kind == ShapeKind::kRectangle;
    is_usable_.push_back(planar && !sharp && is_linear(track, s, kMaxBend * plan_.pixel_size));
  }
}

bool FilledPixels::applies(const RenderPlan& plan, std::size_t number) {
  const Camera& camera = plan.settings.model.cameras[number];
  const bool sharp = !camera.has_depth_of_field() && camera.psf_sigma_px == 0.0;
  return sharp && SheetLight(plan.laser).is_simple() && plan.settings.speckle_contrast == 0.0;
}

/// Returns true when the pixel may be integrated.
bool FilledPixels::is_plane(const Patch& patch) const {
  return patch.shape >= 0 && patch.in_light && is_usable_[static_cast<std::size_t>(patch.shape)];
}

void FilledPixels::collect(int column, int row, const Patch& patch, Batch& batch) const {
  const Shape& shape = views_.query.scene().shapes()[static_cast<std::size_t>(patch.shape)];
  FacePlane plane{{0.0, 0.0, 1.0}, 0.0};  // of a rectangle
  if (shape.kind == ShapeKind::kMesh) {
    plane = patch.count == 0 ? patch.plane : shape.planes[patch.face[0]];
  }
  const int l = batch.count++;
  const auto i = static_cast<std::size_t>(l);
  batch.column[i] = column;
  batch.row[i] = row;
  batch.patch[i] = patch;
  const PixelRays::PixelRay ray = rays_.pixel_ray(column, row);
  batch.x[l] = ray.x;
  batch.y[l] = ray.y;
  batch.dx_du[l] = ray.dx_du;
  batch.dx_dv[l] = ray.dx_dv;
  batch.dy_du[l] = ray.dy_du;
  batch.dy_dv[l] = ray.dy_dv;
  set_lane(batch.normal, l, {plane.normal[0], plane.normal[1], plane.normal[2]});
  batch.offset[l] = plane.offset;
  if (is_single(patch)) return;
  const FacePlane& other = patch.count > 1 ? shape.planes[patch.face[1]] : plane;
  set_lane(batch.other_normal, l, {other.normal[0], other.normal[1], other.normal[2]});
  batch.other_offset[l] = other.offset;
  const bool glossy = std::isfinite(shape.surface->lobe_width());  // the BRDF may change much at the edge
  batch.rise[l] =
      patch.count == 2 && !patch.is_open && !glossy ? rise_of(shape, patch.face[0], patch.face[1]) : 0.0;
}

void FilledPixels::integrate(Batch& batch) {
  IntegralConstants constants{{}, {}, plan_.laser, time_scale_};
  std::copy_n(rays_.axes(), 9, constants.axes);
  std::copy_n(rays_.viewpoint(), 3, constants.viewpoint);
  const PoseTrack& track = views_.query.track();
  const auto shape = static_cast<std::size_t>(shape_);
  const Rigid3& start = track.shape_from_reference(shape, 0);
  const Rigid3& end = track.shape_from_reference(shape, track.instants() - 1);
  const PlanePose first{start.rotation.data(), start.translation.data()};
  const PlanePose last{end.rotation.data(), end.translation.data()};
  fill_up(batch);
  integrate_planes(constants, first, last, batch, light_);
  if (&batch == &edges_) integrate_edges(constants, first, last, batch, light_);
}

double FilledPixels::electrons_per_second(const Batch& batch, int l) const {
  const auto i = static_cast<std::size_t>(l);
  const double ambient = plan_.settings.model.ambient_irradiance;
  const Bsdf& brdf = views_.brdf(shape_);
  const bool is_edge = !is_single(batch.patch[i]) && light_.is_edge[l] > 0.0;
  const double share = is_edge ? light_.share[l] : 0.0;
  const double irradiance = (is_edge ? 1.0 + light_.brightening[l] : 1.0) * light_.irradiance[l];
  const double cosines = is_edge ? light_.cosines[l] : 1.0;
  double light = 0.0;
  if (brdf.is_lambert()) {
    light = brdf.albedo(1.0) * (irradiance * (1.0 + share * (cosines - 1.0)) + ambient);
  } else {
    const Eigen::Vector3d to_viewpoint = -lane(light_.direction, l).normalized();
    const Eigen::Vector3d to_source = -lane(light_.from_source, l).normalized();
    const auto reflected = [&](const Lanes3& normals, double laser) {
      Eigen::Vector3d normal = lane(normals, l).normalized();
      if (normal.dot(to_viewpoint) < 0.0) normal = -normal;
      const double sum = ambient > 0.0 ? ambient * brdf.albedo(normal.dot(to_viewpoint)) : 0.0;
      if (!(laser > 0.0)) return sum;
      const double here = brdf.pi_brdf(normal, to_source, to_viewpoint);
      if (!std::isfinite(brdf.lobe_width())) return sum + laser * here;
      const Eigen::Vector3d other_viewpoint =
          -(lane(light_.direction, l) + lane(light_.change_of_direction, l)).normalized();
      const Eigen::Vector3d other_source =
          -(lane(light_.from_source, l) + lane(light_.change_of_point, l)).normalized();
      const double change = brdf.pi_brdf(normal, other_source, other_viewpoint) - here;
      return sum + laser * (here + light_.per_change[l] * change);
    };
    light = (1.0 - share) * reflected(light_.normal, irradiance);
    if (share > 0.0) light += share * reflected(light_.other_normal, cosines * irradiance);
  }
  return light > 0.0 ? rays_.electrons(batch.column[i], batch.row[i], light) : 0.0;
}

}  // namespace sensor_rt
