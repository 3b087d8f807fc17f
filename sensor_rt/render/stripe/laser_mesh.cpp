#include "sensor_rt/render/stripe/laser_mesh.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sensor_rt/scene/bsdf/subsurface.h"

namespace sensor_rt {
namespace {

constexpr int kSlopes = 7;        ///< grid rays through the thickness of the sheet
constexpr double kFlat = 0.025;   ///< px: largest distance of the surface from a straight edge of the mesh
constexpr double kClose = 0.5;    ///< px: largest distance of a vertex from the tangent plane of another
constexpr double kLargest = 4.0;  ///< px: size up to which a quadrilateral is linear in the image
constexpr double kLargestWide = 32.0;   ///< px: the same for light from below the surface
constexpr double kFine = 0.5;           ///< size of its quadrilaterals in standard deviations
constexpr double kEven = 0.15;          ///< relative difference of brightness that is linear up to that size
constexpr double kLargestUneven = 1.0;  ///< px: the same size where brightness differs more
constexpr double kSmallest = 0.5;       ///< px: size below which an edge is not bisected further
constexpr double kMargin = 8.0;         ///< px around an image, beyond the largest quadrilateral
constexpr int kMaxAlong = 6;            ///< bisections along the fan at an edge
constexpr int kMaxAcross = 7;           ///< the same across the fan
constexpr int kMaxSteep = 9;  ///< bisections of a steep surface, from the width of an image to kLargest

}  // namespace

LaserMesh::Beam LaserMesh::middle(const Beam& a, const Beam& b) {
  const double y = a.y + b.y;
  const double z = a.z + b.z;
  const double scale = 1.0 / std::sqrt(y * y + z * z);
  return {scale * y, scale * z, 0.5 * (a.slope + b.slope)};
}

void LaserMesh::set(const RenderPlan& plan, const Scene& scene, const StripeSamples& samples) {
  plan_ = &plan;
  scene_ = &scene;
  samples_ = &samples;
  const SceneQuery query(scene, samples.track());
  const std::size_t lanes = samples.size() * kLanes;
  std::vector<std::size_t> instants(lanes);
  std::vector<Eigen::Vector3d> origins(lanes);
  const auto set_view = [&](const auto& origin, const std::vector<HalfSpace>& region, RayView& view) {
    for (std::size_t i = 0; i < lanes; ++i) {
      instants[i] = i / kLanes;
      origins[i] = origin(plan.stripe_lattice[samples.lattice_point(i / kLanes)]);
    }
    view.set(query, origins, instants, region);
  };
  set_view([](const LatticePoint& point) { return point.source; }, plan.laser_region, laser_);
  const std::size_t count = plan.stripe_cameras.size();
  cameras_.resize(count);
  images_.resize(count);
  edges_.resize(count);
  for (std::size_t c = 0; c < count; ++c) {
    set_view([c](const LatticePoint& point) { return point.lenses[c].viewpoint; },
             plan.stripe_cameras[c].region, cameras_[c]);
  }
}

bool LaserMesh::has_subsurface() const {
  return std::any_of(laser_.shapes().begin(), laser_.shapes().end(),
                     [this](std::size_t s) { return scene_->shapes()[s].surface->subsurface() != nullptr; });
}

void LaserMesh::build(std::size_t sample, int part) {
  sample_ = sample;
  part_ = part;
  reach_ = 0.0;
  for (const std::size_t s : laser_.shapes()) {
    const Subsurface* medium = scene_->shapes()[s].surface->subsurface();
    if (medium != nullptr && part >= 0) reach_ = std::max(reach_, medium->reach(part));
  }
  // A wide Gaussian changes little within a quadrilateral.
  largest_ = std::clamp(kFine * reach_ / plan_->pixel_size, kLargest, kLargestWide);
  lattice_point_ = samples_->lattice_point(sample);
  beams_.clear();
  quads_.clear();
  open_.clear();
  for (std::size_t c = 0; c < edges_.size(); ++c) {
    edges_[c].assign(static_cast<std::size_t>(plan_->stripe_cameras[c].optics.width_px), 0);
  }
  if (is_empty()) return;
  const double rays = plan_->settings.rays_across_fan * kLargest / largest_;
  const auto angles = static_cast<std::uint32_t>(std::max(std::ceil(rays), 2.0));
  const double half = plan_->settings.model.laser.fan_half_angle;
  const double slope = plan_->slope + kSheetReach * reach_ / plan_->nearest;
  for (std::uint32_t i = 0; i < angles; ++i) {
    const double angle = half * (2.0 * i / (angles - 1) - 1.0);
    beams_.push_back({std::sin(angle), std::cos(angle), -slope});
  }
  for (int j = 1; j < kSlopes; ++j) {
    const double share = 2.0 * j / (kSlopes - 1) - 1.0;
    for (std::uint32_t i = 0; i < angles; ++i) beams_.push_back({beams_[i].y, beams_[i].z, share * slope});
  }
  cast(0);
  for (std::uint32_t j = 0; j + 1 < kSlopes; ++j) {
    for (std::uint32_t i = 0; i + 1 < angles; ++i) {
      const std::uint32_t at = j * angles + i;
      consider({{at, at + 1, at + angles + 1, at + angles}});
    }
  }
  while (!open_.empty()) refine();
}

void LaserMesh::cast(std::size_t first) {
  vertices_.resize(beams_.size());
  for (std::vector<Image>& images : images_) images.resize(beams_.size());
  for (std::size_t at = first; at < beams_.size(); at += kLanes) {
    cast_packet(at, static_cast<int>(std::min<std::size_t>(kLanes, beams_.size() - at)));
  }
}

void LaserMesh::cast_packet(std::size_t first, int count) {
  const Eigen::Vector3d& source = plan_->stripe_lattice[lattice_point_].source;
  Lanes3 direction;
  alignas(64) int valid[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const Beam& beam = beams_[first + static_cast<std::size_t>(std::min(l, count - 1))];
    set_lane(direction, l, plan_->laser.direction(beam.y, beam.z, beam.slope));
  }
  activate_lanes(static_cast<std::size_t>(count), valid);
  PacketHits hits;
  laser_.intersect(sample_, direction, valid, hits);
  Lanes3 points;
  for (int l = 0; l < kLanes; ++l) {
    const double t = hits.shape[l] >= 0 ? hits.t[l] : 1.0;
    set_lane(points, l, source + t * lane(direction, l));
  }
  for (int l = 0; l < count; ++l) {
    const std::size_t number = first + static_cast<std::size_t>(l);
    Vertex& vertex = vertices_[number];
    vertex.shape = hits.shape[l];
    if (vertex.shape < 0) continue;
    vertex.point = lane(points, l);
    vertex.normal = lane(hits.normal, l);
    if (vertex.normal.dot(lane(direction, l)) > 0.0) vertex.normal = -vertex.normal;
    const double depth = vertex.point.z() - source.z();
    vertex.across =
        hits.t[l] * beams_[number].slope / std::sqrt(plan_->laser.variance(depth) + reach_ * reach_);
  }
  if (part_ >= 0) find_entries(first, count);
  for (std::size_t c = 0; c < cameras_.size(); ++c) view_packet(c, first, count, points);
}

/// Finds where the light of vertices enters: in the middle of the sheet.
void LaserMesh::find_entries(std::size_t first, int count) {
  constexpr double kRise = 0.3;  // of the surface between entry and vertex, relative to their distance
  const Eigen::Vector3d& source = plan_->stripe_lattice[lattice_point_].source;
  Lanes3 direction;
  alignas(64) int valid[kLanes];
  for (int l = 0; l < kLanes; ++l) {
    const Beam& beam = beams_[first + static_cast<std::size_t>(std::min(l, count - 1))];
    set_lane(direction, l, plan_->laser.direction(beam.y, beam.z, 0.0));
  }
  activate_lanes(static_cast<std::size_t>(count), valid);
  PacketHits hits;
  laser_.intersect(sample_, direction, valid, hits);
  for (int l = 0; l < count; ++l) {
    Vertex& vertex = vertices_[first + static_cast<std::size_t>(l)];
    if (vertex.shape < 0) continue;
    vertex.entry = source + hits.t[l] * lane(direction, l);
    const Eigen::Vector3d step = vertex.point - vertex.entry;
    vertex.is_entry_near = hits.shape[l] == vertex.shape &&
                           std::abs(step.dot(vertex.normal)) <= kRise * step.norm() + plan_->pixel_size;
  }
}

void LaserMesh::view_packet(std::size_t number, std::size_t first, int count, const Lanes3& points) {
  const StripeCamera& stripe_camera = plan_->stripe_cameras[number];
  const Camera& camera = stripe_camera.optics;
  const LensPoint& lens = plan_->stripe_lattice[lattice_point_].lenses[number];
  alignas(64) double column[kLanes];
  alignas(64) double row[kLanes];
  stripe_camera.projector.project(points, column, row);
  Lanes3 segment;
  alignas(64) int unoccluded[kLanes] = {};
  for (int l = 0; l < kLanes; ++l) set_lane(segment, l, Eigen::Vector3d::UnitZ());
  for (int l = 0; l < count; ++l) {
    const std::size_t at = first + static_cast<std::size_t>(l);
    const Vertex& vertex = vertices_[at];
    Image& image = images_[number][at];
    image = {};
    if (vertex.shape < 0) continue;
    image.column = column[l];
    image.row = row[l];
    if (column[l] != kNotVisible && !lens.is_centre) {
      Eigen::Vector2d pixel(column[l], row[l]);
      if (camera.has_depth_of_field()) {
        pixel = camera.project_through(lens.in_camera, stripe_camera.camera_from_reference * vertex.point);
      }
      image.column = pixel.x() + lens.blur_px.x();
      image.row = pixel.y() + lens.blur_px.y();
    }
    const bool is_outside = image.column < -kMargin || image.column > camera.width_px + kMargin ||
                            image.row < -kMargin || image.row > camera.height_px + kMargin;
    const Eigen::Vector3d from_viewpoint = vertex.point - lens.viewpoint;
    if (is_outside) {
      image.state = State::kOutside;
    } else if (vertex.normal.dot(from_viewpoint) < 0.0) {
      unoccluded[l] = -1;
    }
    set_lane(segment, l, from_viewpoint);
  }
  if (!any_lane(unoccluded)) return;
  cameras_[number].occlude(sample_, segment, unoccluded);
  for (int l = 0; l < count; ++l) {
    if (unoccluded[l] == 0) continue;
    const std::size_t at = first + static_cast<std::size_t>(l);
    Image& image = images_[number][at];
    image.state = State::kSeen;
    illuminate(number, vertices_[at], image);
  }
}

void LaserMesh::illuminate(std::size_t number, const Vertex& vertex, Image& image) const {
  const Camera& camera = plan_->stripe_cameras[number].optics;
  const LaserEmitter& laser = plan_->laser;
  const Eigen::Vector3d& lit = part_ < 0 ? vertex.point : vertex.entry;
  const Eigen::Vector3d from_source = lit - plan_->stripe_lattice[lattice_point_].source;
  const Eigen::Vector3d to_viewpoint = camera.sensor_from_camera.translation - vertex.point;
  const double y = from_source.y();
  const double depth = from_source.z();
  const double sheet_variance = laser.variance(depth);
  const double irradiance =
      laser.relative_power(y, depth) *
      laser.peak_irradiance(-vertex.normal.dot(from_source), sheet_variance, from_source.x(), y, depth);
  const Shape& shape = scene_->shapes()[static_cast<std::size_t>(vertex.shape)];
  const Bsdf& bsdf = *shape.surface;
  double variance = sheet_variance;
  image.across = vertex.across;
  if (bsdf.is_lambert()) {
    image.light = shape.reflectance;
  } else {
    const Rigid3& shape_from_reference =
        samples_->track().shape_from_reference(static_cast<std::size_t>(vertex.shape), sample_);
    const SurfaceFrame surface = shape.frame(shape_from_reference, vertex.point, vertex.normal);
    const Eigen::Vector3d to_source = -from_source.normalized();
    const Eigen::Vector3d towards = to_viewpoint.normalized();
    const Subsurface* medium = bsdf.subsurface();
    const double below = bsdf.pi_subsurface(surface, to_source, towards);
    image.light = part_ < 0 ? bsdf.pi_brdf(surface, to_source, towards) - below : below;
    if (medium != nullptr && part_ >= 0) spread_below(*medium, vertex, to_source, towards, image, variance);
  }
  if (part_ >= 0 && !(vertex.is_entry_near && bsdf.subsurface() != nullptr)) image.light = 0.0;
  const double along_axis = camera.sensor_from_camera.rotation.col(2).dot(to_viewpoint);
  const double cosine2 = along_axis * along_axis / to_viewpoint.squaredNorm();
  const double area = camera.is_tilted() ? camera.tilt_area({image.column, image.row}) : 1.0;
  // Motion of the surface along its normal shifts what a pixel sees across the sheet: the mean of the
  // Gaussian over the shift is a Gaussian of larger variance.
  const double normal_travel = vertex.normal.dot(samples_->travel(vertex.shape, sample_, vertex.point));
  const double shift = normal_travel * to_viewpoint.x() / vertex.normal.dot(to_viewpoint);
  const double wider = 1.0 / std::sqrt(1.0 + shift * shift / (12.0 * variance));
  image.light =
      wider * (irradiance * image.light) * cosine2 * cosine2 * area * plan_->electrons_per_irradiance[number];
  image.across *= wider;
}

/// Spreads light that leaves beside its entry: the Gaussian of the sheet is convolved with that of the part.
void LaserMesh::spread_below(const Subsurface& medium, const Vertex& vertex, const Eigen::Vector3d& to_source,
                             const Eigen::Vector3d& to_viewpoint, Image& image, double& variance) const {
  const Eigen::Vector3d& normal = vertex.normal;
  // Along the surface, away from the line of the laser.
  const Eigen::Vector3d across = (Eigen::Vector3d::UnitX() - normal.x() * normal).normalized();
  const Subsurface::Direction from(medium, normal.dot(to_source), across.dot(to_source));
  const Subsurface::Direction towards(medium, normal.dot(to_viewpoint), across.dot(to_viewpoint));
  const Subsurface::Part part = medium.part(part_, from, towards);
  const double x_per_distance = across.x();
  const double sheet_variance = variance;
  variance += part.variance * x_per_distance * x_per_distance;
  image.light *= part.share * std::sqrt(sheet_variance / variance);
  image.across = x_per_distance * (across.dot(vertex.point - vertex.entry) - part.mean) / std::sqrt(variance);
}

bool LaserMesh::are_continuous(std::uint32_t a, std::uint32_t b) const {
  const Vertex& from = vertices_[a];
  const Vertex& to = vertices_[b];
  if (from.shape != to.shape || from.shape < 0) return false;
  const Eigen::Vector3d step = to.point - from.point;
  const double p = std::abs(step.dot(from.normal));
  const double q = std::abs(step.dot(to.normal));
  // Two planes that meet between the vertices have this distance from the line between these.
  const double limit = plan_->pixel_size;
  if (std::max(p, q) > kClose * limit || p * q > kFlat * limit * (p + q)) return false;
  return std::all_of(images_.begin(), images_.end(), [&](const std::vector<Image>& images) {
    return images[a].state == images[b].state || images[a].state == State::kOutside ||
           images[b].state == State::kOutside;
  });
}

/// Returns whether a camera may see a part of a quadrilateral: a corner, or something between corners on
/// different sides of the image.
bool LaserMesh::may_see(std::size_t number, const Quad& quad) const {
  const std::vector<Image>& images = images_[number];
  const auto is_seen = [&](std::uint32_t corner) { return images[corner].state == State::kSeen; };
  if (std::any_of(quad.corner.begin(), quad.corner.end(), is_seen)) return true;
  const Camera& camera = plan_->stripe_cameras[number].optics;
  Eigen::AlignedBox2d box;
  for (const std::uint32_t corner : quad.corner) {
    const Image& image = images[corner];
    if (image.state == State::kOutside && image.column != kNotVisible) {
      box.extend(Eigen::Vector2d(image.column, image.row));
    }
  }
  const Eigen::AlignedBox2d field(Eigen::Vector2d(-0.5, -0.5),
                                  Eigen::Vector2d(camera.width_px - 0.5, camera.height_px - 0.5));
  return !box.isEmpty() && box.intersects(field);
}

/// Returns whether the brightness changes much within a quadrilateral, as between facets at grazing
/// incidence.
bool LaserMesh::is_uneven(const Quad& quad) const {
  return std::any_of(images_.begin(), images_.end(), [&](const std::vector<Image>& images) {
    double least = std::numeric_limits<double>::infinity();
    double most = 0.0;
    for (const std::uint32_t corner : quad.corner) {
      if (images[corner].state != State::kSeen) continue;
      least = std::min(least, images[corner].light);
      most = std::max(most, images[corner].light);
    }
    return most > (1.0 + kEven) * least;
  });
}

LaserMesh::Fit LaserMesh::fit(const Quad& quad) const {
  const auto& [a, b, c, d] = quad.corner;
  double least = std::numeric_limits<double>::infinity();
  double most = -least;
  for (const std::uint32_t corner : quad.corner) {
    if (vertices_[corner].shape < 0) continue;
    least = std::min(least, vertices_[corner].across);
    most = std::max(most, vertices_[corner].across);
  }
  if (least > kSheetReach || most < -kSheetReach) return Fit::kDark;
  double along = -1.0;  // largest size in the images, px
  double across = -1.0;
  for (std::size_t number = 0; number < images_.size(); ++number) {
    if (!may_see(number, quad)) continue;
    const auto size = [&](std::uint32_t from, std::uint32_t to) {
      const Image& p = images_[number][from];
      const Image& q = images_[number][to];
      if (p.column == kNotVisible || q.column == kNotVisible) return 0.0;
      return std::max(std::abs(p.column - q.column), std::abs(p.row - q.row));
    };
    along = std::max({along, size(a, b), size(d, c)});
    across = std::max({across, size(a, d), size(b, c)});
  }
  if (along < 0.0) return Fit::kDark;  // no camera sees it
  const bool is_broken_along = !are_continuous(a, b) || !are_continuous(d, c);
  const bool is_broken_across = !are_continuous(a, d) || !are_continuous(b, c);
  if (!is_broken_along && !is_broken_across) {
    const double largest = part_ < 0 && is_uneven(quad) ? kLargestUneven : largest_;
    if (std::max(along, across) <= largest || std::max(quad.along, quad.across) >= kMaxSteep)
      return Fit::kWhole;
    return along > across ? Fit::kSplitAlong : Fit::kSplitAcross;
  }
  const bool can_split_along = is_broken_along && quad.along < kMaxAlong;
  const bool can_split_across = is_broken_across && quad.across < kMaxAcross;
  if (can_split_along && (!can_split_across || quad.along <= quad.across)) return Fit::kSplitAlong;
  if (can_split_across) return Fit::kSplitAcross;
  const bool all_hit = std::all_of(quad.corner.begin(), quad.corner.end(),
                                   [&](std::uint32_t corner) { return vertices_[corner].shape >= 0; });
  if (!all_hit || std::max(along, across) > kSmallest) return Fit::kEdge;
  const bool alike = std::all_of(images_.begin(), images_.end(), [&](const std::vector<Image>& images) {
    return std::all_of(quad.corner.begin(), quad.corner.end(),
                       [&](std::uint32_t corner) { return images[corner].state == images[a].state; });
  });
  return alike ? Fit::kWhole : Fit::kBorder;
}

void LaserMesh::mark_edge(const Quad& quad) {
  for (std::size_t c = 0; c < images_.size(); ++c) {
    for (const std::uint32_t corner : quad.corner) {
      const Image& image = images_[c][corner];
      if (image.state != State::kSeen) continue;
      const int last = plan_->stripe_cameras[c].optics.width_px - 1;
      const int middle = static_cast<int>(std::lround(image.column));
      for (int column = std::max(0, middle - 1); column <= std::min(last, middle + 1); ++column) {
        edges_[c][static_cast<std::size_t>(column)] = 1;
      }
    }
  }
}

void LaserMesh::consider(const Quad& quad) {
  const Fit found = fit(quad);
  switch (found) {
    case Fit::kDark:
      return;
    case Fit::kEdge:
      return mark_edge(quad);
    case Fit::kBorder:
      mark_edge(quad);
      [[fallthrough]];
    case Fit::kWhole:
      return quads_.push_back(quad);
    case Fit::kSplitAlong:
    case Fit::kSplitAcross:
      open_.push_back(quad);
      open_.back().splits_along = found == Fit::kSplitAlong;
  }
}

void LaserMesh::refine() {
  bisected_.swap(open_);
  open_.clear();
  const std::size_t base = beams_.size();
  for (const Quad& quad : bisected_) {
    const auto& [a, b, c, d] = quad.corner;
    beams_.push_back(middle(beams_[a], beams_[quad.splits_along ? b : d]));
    beams_.push_back(middle(beams_[quad.splits_along ? d : b], beams_[c]));
  }
  cast(base);
  for (std::size_t k = 0; k < bisected_.size(); ++k) {
    const Quad& quad = bisected_[k];
    const auto& [a, b, c, d] = quad.corner;
    const auto first = static_cast<std::uint32_t>(base + 2 * k);
    const std::uint32_t second = first + 1;
    if (quad.splits_along) {
      consider({{a, first, second, d}, quad.along + 1, quad.across});
      consider({{first, b, c, second}, quad.along + 1, quad.across});
    } else {
      consider({{a, b, second, first}, quad.along, quad.across + 1});
      consider({{first, second, c, d}, quad.along, quad.across + 1});
    }
  }
}

}  // namespace sensor_rt
