#include "sensor_rt/render/filled_pixels.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/fast_math.h"
#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

/// Largest deviation of a pose from linear motion, in pixels: it shifts the centre of a stripe.
constexpr double kMaxBend = 3e-4;
/// Distance from the origin of a shape's frame within which kMaxBend holds, m.
constexpr double kArm = 0.3;
/// Smallest width of a lobe, rad: it is nearly constant over a pixel.
constexpr double kMinLobe = 0.1;

struct Constants {
  double axes[9];
  double viewpoint[3];
  const LaserEmitter& laser;
  double time_scale;
};

/// A plane's pose: rotation (column-major) and translation of shape_from_reference.
struct PlanePose {
  const double* rotation;
  const double* translation;
};

/// Plane of a lane in the reference frame: n . x = offset.
struct PlaneLane {
  double x, y, z, offset;
};

[[gnu::always_inline]] inline PlaneLane place(const PlanePose& p, const Lanes3& normal, const double* offset,
                                              int l) {
  const double* r = p.rotation;
  const double nx = normal.x[l];
  const double ny = normal.y[l];
  const double nz = normal.z[l];
  return {r[0] * nx + r[1] * ny + r[2] * nz, r[3] * nx + r[4] * ny + r[5] * nz,
          r[6] * nx + r[7] * ny + r[8] * nz,
          offset[l] - nx * p.translation[0] - ny * p.translation[1] - nz * p.translation[2]};
}

/// Distance from the centre of the sheet at the hit of direction (dx, dy, dz) with a plane, in standard
/// deviations.
[[gnu::always_inline]] inline double across_sheet(const Constants& c, const PlaneLane& p, double dx,
                                                  double dy, double dz) {
  const double t = (p.offset - p.x * c.viewpoint[0] - p.y * c.viewpoint[1] - p.z * c.viewpoint[2]) /
                   (p.x * dx + p.y * dy + p.z * dz);
  const double depth = c.viewpoint[2] + t * dz - c.laser.sheet.source_z;
  return (c.viewpoint[0] + t * dx) / std::sqrt(c.laser.variance(depth));
}

/// Mean of exp(-q²/2) over intervals of widths with these sums of squares, fourth and sixth powers.
[[gnu::always_inline]] inline double mean_gaussian(double q, double w2, double w4, double w6) {
  const double variance = 1.0 + w2 * (1.0 / 12.0);
  const double z2 = q * q / variance;
  const double inverse2 = 1.0 / variance;
  const double fourth = -w4 * (1.0 / 120.0) * inverse2 * inverse2;
  const double sixth = w6 * (1.0 / 252.0) * inverse2 * inverse2 * inverse2;
  // Hermite polynomials He4, He6, He8
  const double he4 = (z2 - 6.0) * z2 + 3.0;
  const double he6 = ((z2 - 15.0) * z2 + 45.0) * z2 - 15.0;
  const double he8 = (((z2 - 28.0) * z2 + 210.0) * z2 - 420.0) * z2 + 105.0;
  const double series = 1.0 + fourth * (1.0 / 24.0) * he4 + sixth * (1.0 / 720.0) * he6 +
                        fourth * fourth * (1.0 / 1152.0) * he8;
  const double exponent = -0.5 * z2;
  return exp_negative(exponent > -600.0 ? exponent : -600.0) * series * std::sqrt(inverse2);
}

/// Conditions are combined by & and applied as factors: the loop vectorises only without branches.
SENSOR_RT_MULTIVERSION
void integrate_lanes(const Constants& c, const PlanePose& first, const PlanePose& last,
                     const FilledPixels::Batch& __restrict b, FilledPixels::Light& __restrict out) {
  constexpr double kMaxWidth2 = 2.25;  // the series then errs by 1e-4 of the peak
  constexpr double kMaxLean = 0.01;    // change of the distance from pixel to pixel
  const double* a = c.axes;
  const LaserEmitter& laser = c.laser;
  for (int l = 0; l < kLanes; ++l) {
    const PlaneLane p = place(first, b.normal, b.offset, l);
    const PlaneLane q = place(last, b.normal, b.offset, l);
    const double dx = a[0] * b.x[l] + a[3] * b.y[l] + a[6];
    const double dy = a[1] * b.x[l] + a[4] * b.y[l] + a[7];
    const double dz = a[2] * b.x[l] + a[5] * b.y[l] + a[8];
    const double at_first = across_sheet(c, p, dx, dy, dz);
    const double at_last = across_sheet(c, q, dx, dy, dz);
    // At mid-exposure:
    const double nx = 0.5 * (p.x + q.x);
    const double ny = 0.5 * (p.y + q.y);
    const double nz = 0.5 * (p.z + q.z);
    const double offset = 0.5 * (p.offset + q.offset);
    const double slope = nx * dx + ny * dy + nz * dz;
    const double inverse = 1.0 / slope;
    const double t = (offset - nx * c.viewpoint[0] - ny * c.viewpoint[1] - nz * c.viewpoint[2]) * inverse;
    const double x = c.viewpoint[0] + t * dx;
    const double y = c.viewpoint[1] + t * dy;
    const double depth = c.viewpoint[2] + t * dz - laser.sheet.source_z;
    const double sigma2 = laser.variance(depth);
    const double inverse_sigma = 1.0 / std::sqrt(sigma2);
    // Derivatives of the ray and of the hit by column (u) and row (v):
    const double ux = a[0] * b.dx_du[l] + a[3] * b.dy_du[l];
    const double uy = a[1] * b.dx_du[l] + a[4] * b.dy_du[l];
    const double uz = a[2] * b.dx_du[l] + a[5] * b.dy_du[l];
    const double vx = a[0] * b.dx_dv[l] + a[3] * b.dy_dv[l];
    const double vy = a[1] * b.dx_dv[l] + a[4] * b.dy_dv[l];
    const double vz = a[2] * b.dx_dv[l] + a[5] * b.dy_dv[l];
    const double lean_u = (nx * ux + ny * uy + nz * uz) * inverse;
    const double lean_v = (nx * vx + ny * vy + nz * vz) * inverse;
    const double widening =
        laser.divergence2 * (depth - laser.waist_depth) * x * inverse_sigma * inverse_sigma;
    const double in_u = t * inverse_sigma * (ux - lean_u * dx - widening * (uz - lean_u * dz));
    const double in_v = t * inverse_sigma * (vx - lean_v * dx - widening * (vz - lean_v * dz));
    const double in_t = c.time_scale * (at_last - at_first);
    const double u2 = in_u * in_u;
    const double v2 = in_v * in_v;
    const double t2 = in_t * in_t;
    const double w2 = u2 + v2 + t2;
    // To first order, a change of the other factors across the pixel and a curvature of the distance shift
    // the Gaussian: by a twelfth of the products of the gradients.
    const double in_fan2 = y * y + depth * depth;
    const double fall = -2.0 * t / in_fan2;  // of 1/radius and of the cosine's 1/distance
    const double fall_u = fall * (y * (uy - lean_u * dy) + depth * (uz - lean_u * dz)) - lean_u;
    const double fall_v = fall * (y * (vy - lean_v * dy) + depth * (vz - lean_v * dz)) - lean_v;
    const double across = x * inverse_sigma + (fall_u * in_u + fall_v * in_v) * (1.0 / 12.0);
    const double mean =
        mean_gaussian(across, w2, u2 * u2 + v2 * v2 + t2 * t2, u2 * u2 * u2 + v2 * v2 * v2 + t2 * t2 * t2);
    const double half_width = 0.5 * (std::abs(in_u) + std::abs(in_v) + std::abs(in_t));
    const double half_y = t * (std::abs(uy) + std::abs(vy) + std::abs(lean_u * dy) + std::abs(lean_v * dy));
    const double half_z = t * (std::abs(uz) + std::abs(vz) + std::abs(lean_u * dz) + std::abs(lean_v * dz));
    const double to_source = -(nx * x + ny * y + nz * depth);
    const double facing = slope > 0.0 ? -to_source : to_source;
    const double shine = std::abs(across) - half_width <= kSheetReach ? 1.0 : 0.0;
    const bool simple = (w2 <= kMaxWidth2) & (std::abs(lean_u) <= kMaxLean) & (std::abs(lean_v) <= kMaxLean) &
                        (t > 0.0) & (facing > 0.0) & laser.in_fan(std::abs(y) + half_y, depth - half_z);
    out.needs_samples[l] = simple ? 0.0 : 1.0;
    out.irradiance[l] = shine * mean * laser.peak_irradiance(facing, sigma2, x, y, depth);
    const double slope_of_mean = -across / (1.0 + w2 * (1.0 / 12.0));
    out.per_distance[l] = slope_of_mean * inverse_sigma * (dx - widening * dz);
    out.per_change[l] = slope_of_mean * (1.0 / 12.0);
    out.change_of_direction.x[l] = in_u * ux + in_v * vx;
    out.change_of_direction.y[l] = in_u * uy + in_v * vy;
    out.change_of_direction.z[l] = in_u * uz + in_v * vz;
    const double lean = in_u * lean_u + in_v * lean_v;
    out.change_of_point.x[l] = t * (out.change_of_direction.x[l] - lean * dx);
    out.change_of_point.y[l] = t * (out.change_of_direction.y[l] - lean * dy);
    out.change_of_point.z[l] = t * (out.change_of_direction.z[l] - lean * dz);
    out.distance[l] = t;
    out.direction.x[l] = dx;
    out.direction.y[l] = dy;
    out.direction.z[l] = dz;
    out.normal.x[l] = nx;
    out.normal.y[l] = ny;
    out.normal.z[l] = nz;
    out.from_source.x[l] = x;
    out.from_source.y[l] = y;
    out.from_source.z[l] = depth;
  }
}

/// Inverse distances from the viewpoint to two planes, their difference g along a direction.
struct PlanePair {
  PlaneLane a, b;
  double scale_a, scale_b;
};

[[gnu::always_inline]] inline PlanePair pair_up(const Constants& c, const PlaneLane& a, const PlaneLane& b) {
  const double* v = c.viewpoint;
  return {a, b, 1.0 / (a.offset - a.x * v[0] - a.y * v[1] - a.z * v[2]),
          1.0 / (b.offset - b.x * v[0] - b.y * v[1] - b.z * v[2])};
}

[[gnu::always_inline]] inline double difference(const PlanePair& p, double dx, double dy, double dz) {
  return (p.b.x * dx + p.b.y * dy + p.b.z * dz) * p.scale_b -
         (p.a.x * dx + p.a.y * dy + p.a.z * dz) * p.scale_a;
}

[[gnu::always_inline]] inline PlaneLane mean_plane(const PlaneLane& a, const PlaneLane& b) {
  return {0.5 * (a.x + b.x), 0.5 * (a.y + b.y), 0.5 * (a.z + b.z), 0.5 * (a.offset + b.offset)};
}

/// Adds a second face that meets the first one at an edge. The difference g of inverse distances is linear in
/// column, row and time; its sign tells the faces apart. Share and mean height of the second face are the
/// means of the step and of the ramp of g over the three intervals: differences of powers at their eight
/// corners.
SENSOR_RT_MULTIVERSION
void integrate_edges(const Constants& c, const PlanePose& first, const PlanePose& last,
                     const FilledPixels::Batch& __restrict b, FilledPixels::Light& __restrict out) {
  constexpr double kMaxCosines = 0.01;      // relative difference of cosines
  constexpr double kMaxBrightening = 0.02;  // relative difference of irradiance by that of distance
  constexpr double kNarrow = 1e-3;          // least width of an interval, relative to their sum
  const double* a = c.axes;
  for (int l = 0; l < kLanes; ++l) {
    const PlanePair start =
        pair_up(c, place(first, b.normal, b.offset, l), place(first, b.other_normal, b.other_offset, l));
    const PlanePair end =
        pair_up(c, place(last, b.normal, b.offset, l), place(last, b.other_normal, b.other_offset, l));
    const PlanePair middle = pair_up(c, mean_plane(start.a, end.a), mean_plane(start.b, end.b));
    const double dx = out.direction.x[l];
    const double dy = out.direction.y[l];
    const double dz = out.direction.z[l];
    // The face is met before the first one's plane where it rises towards the viewpoint, else behind it.
    const double side = middle.scale_a < 0.0 ? b.rise[l] : -b.rise[l];
    const double g = side * difference(middle, dx, dy, dz);
    const double in_u =
        std::abs(difference(middle, a[0] * b.dx_du[l] + a[3] * b.dy_du[l],
                            a[1] * b.dx_du[l] + a[4] * b.dy_du[l], a[2] * b.dx_du[l] + a[5] * b.dy_du[l]));
    const double in_v =
        std::abs(difference(middle, a[0] * b.dx_dv[l] + a[3] * b.dy_dv[l],
                            a[1] * b.dx_dv[l] + a[4] * b.dy_dv[l], a[2] * b.dx_dv[l] + a[5] * b.dy_dv[l]));
    const double in_t = c.time_scale * std::abs(difference(end, dx, dy, dz) - difference(start, dx, dy, dz));
    const double sum = in_u + in_v + in_t + 1e-300;
    const double scale = 1.0 / sum;
    const double u = in_u * scale > kNarrow ? in_u * scale : kNarrow;
    const double v = in_v * scale > kNarrow ? in_v * scale : kNarrow;
    const double w = in_t * scale > kNarrow ? in_t * scale : kNarrow;
    const double raw = g * scale;
    const double low = raw < -1.0 ? -1.0 : raw;
    const double z = low > 1.0 ? 1.0 : low;
    double step = 0.0;
    double ramp = 0.0;
    for (int k = 0; k < 8; ++k) {
      const double su = (k & 1) != 0 ? 0.5 : -0.5;
      const double sv = (k & 2) != 0 ? 0.5 : -0.5;
      const double sw = (k & 4) != 0 ? 0.5 : -0.5;
      const double corner = z + su * u + sv * v + sw * w;
      const double up = corner > 0.0 ? corner : 0.0;
      const double cube = 8.0 * su * sv * sw * up * up * up;
      step += cube;
      ramp += cube * up;
    }
    const double volume = 1.0 / (u * v * w);
    const double share = step * volume * (1.0 / 6.0);
    const double height = ramp * volume * (1.0 / 24.0) * sum;
    const double nx = middle.b.x;
    const double ny = middle.b.y;
    const double nz = middle.b.z;
    const double facing = out.normal.x[l] * out.from_source.x[l] + out.normal.y[l] * out.from_source.y[l] +
                          out.normal.z[l] * out.from_source.z[l];
    const double other = nx * out.from_source.x[l] + ny * out.from_source.y[l] + nz * out.from_source.z[l];
    const double cosines = other / facing;
    const double t = out.distance[l];
    const double per_height = -side * out.per_distance[l] * t * t;
    const bool simple = (b.rise[l] != 0.0) & (std::abs(cosines - 1.0) <= kMaxCosines) &
                        (std::abs(per_height) * sum <= kMaxBrightening);
    out.share[l] = share;
    out.brightening[l] = per_height * height;
    out.cosines[l] = cosines;
    out.is_edge[l] = simple ? 1.0 : 0.0;
    out.other_normal.x[l] = nx;
    out.other_normal.y[l] = ny;
    out.other_normal.z[l] = nz;
  }
}

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
    const Eigen::Matrix3d turned = pose.rotation - (1.0 - share) * from.rotation - share * to.rotation;
    const Eigen::Vector3d moved =
        pose.translation - (1.0 - share) * from.translation - share * to.translation;
    if (!(kArm * turned.norm() + moved.norm() <= tolerance)) return false;
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
  Constants constants{{}, {}, plan_.laser, time_scale_};
  std::copy_n(rays_.axes(), 9, constants.axes);
  std::copy_n(rays_.viewpoint(), 3, constants.viewpoint);
  const PoseTrack& track = views_.query.track();
  const auto shape = static_cast<std::size_t>(shape_);
  const Rigid3& start = track.shape_from_reference(shape, 0);
  const Rigid3& end = track.shape_from_reference(shape, track.instants() - 1);
  const PlanePose first{start.rotation.data(), start.translation.data()};
  const PlanePose last{end.rotation.data(), end.translation.data()};
  fill_up(batch);
  integrate_lanes(constants, first, last, batch, light_);
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
