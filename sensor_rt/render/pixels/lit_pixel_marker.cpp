#include "sensor_rt/render/pixels/lit_pixel_marker.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sensor_rt/render/pixels/pixel_cover.h"

namespace sensor_rt {
namespace {

constexpr std::size_t kSlopes = 5;  ///< grid rays through the thickness of the sheet
constexpr float kCloseGap = 4.0f;   ///< px: largest distance of neighbours that bound a piece of surface
constexpr float kCloseAcross =
    8.0f;                        ///< the same across the sheet, where the grid is coarse: a stripe's width
constexpr float kMargin = 1.0f;  ///< px around a hit: half the pixel size, and the curvature between hits
constexpr float kJustOutside = 1.05f;  ///< of the half width of the sheet: tolerance for rounding
// Largest number of bisections of a gap:
constexpr int kSteepDepth = 20;  ///< on one surface: sufficient for any wall
constexpr int kVoidDepth = 14;   ///< far apart on two surfaces: a missed feature receives 1e-4 of the light
constexpr int kEdgeDepth = 5;    ///< close together on two surfaces: all pixels in between are marked anyway

bool in_sheet(const FanHit& fan_hit) { return fan_hit.hit() && std::abs(fan_hit.across) <= kJustOutside; }

/// Returns true when both hits are on the same side outside the sheet.
bool beside_sheet(const FanHit& a, const FanHit& b) {
  return (a.across > kJustOutside && b.across > kJustOutside) ||
         (a.across < -kJustOutside && b.across < -kJustOutside);
}

bool beyond(float a, float b, int size, float margin) {
  const float last = static_cast<float>(size) + margin;
  return (a < -margin - 1.0f && b < -margin - 1.0f) || (a > last && b > last);
}

}  // namespace

LitPixelMarker::LitPixelMarker(const RenderPlan& plan, const SceneQuery& query, Buffers& buffers)
    : plan_(plan),
      track_(query.track()),
      grid_(plan, query),
      cameras_(plan.settings.model.cameras.size()),
      angles_(static_cast<std::size_t>(plan.settings.rays_across_fan)),
      slopes_(kSlopes),
      buffers_(buffers) {}

void LitPixelMarker::mark(std::vector<PixelMask>& masks) {
  if (grid_.shapes().empty()) return;
  make_grid();
  grid_.cast(buffers_.rays, buffers_.hits);
  buffers_.gaps.clear();
  visit_grid(masks);
  while (!buffers_.gaps.empty()) refine(masks);
}

std::vector<std::size_t> LitPixelMarker::choose_instants() const {
  const std::size_t last = track_.instants() - 1;
  if (last == 0) return {0};
  const double farthest_px = max_motion_px(plan_.settings.model, track_, grid_.shapes());
  constexpr double kStep = 3.0;  // px between neighbouring instants of the grid
  const auto steps =
      static_cast<std::size_t>(std::clamp(std::ceil(farthest_px / kStep), 1.0, static_cast<double>(last)));
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i <= steps; ++i) chosen.push_back(i * last / steps);
  return chosen;
}

void LitPixelMarker::make_grid() {
  const std::vector<std::size_t> chosen = choose_instants();
  std::vector<Eigen::Vector2d> across_fan;  // sine and cosine of each angle
  const double half = plan_.settings.model.laser.fan_half_angle;
  for (std::size_t i = 0; i < angles_; ++i) {
    const double angle = half * (2.0 * static_cast<double>(i) / static_cast<double>(angles_ - 1) - 1.0);
    across_fan.emplace_back(std::sin(angle), std::cos(angle));
  }
  instants_ = chosen.size();
  buffers_.rays.clear();
  for (const std::size_t instant : chosen) {
    for (std::size_t line = 0; line < grid_.sources() * slopes_; ++line) {
      const std::size_t j = line % slopes_;
      const double slope =
          plan_.slope * (2.0 * static_cast<double>(j) / static_cast<double>(slopes_ - 1) - 1.0);
      for (std::size_t i = 0; i < angles_; ++i) {
        buffers_.rays.push_back({across_fan[i].x(), across_fan[i].y(), slope, instant, line / slopes_});
      }
      // All rays of a packet share an instant and a source.
      while (buffers_.rays.size() % kLanes != 0) buffers_.rays.push_back(buffers_.rays.back());
    }
  }
}

void LitPixelMarker::visit_grid(std::vector<PixelMask>& masks) {
  const std::size_t row = (angles_ + kLanes - 1) / kLanes * kLanes;
  const std::size_t to_source = slopes_ * row;
  const std::size_t to_instant = grid_.sources() * to_source;
  const auto pair = [&](std::size_t a, std::size_t b, bool along_sheet = true) {
    visit({buffers_.rays[a], buffers_.rays[b], a, b, 0, !along_sheet, along_sheet}, masks);
  };
  for (std::size_t instant = 0; instant < instants_; ++instant) {
    for (std::size_t source = 0; source < grid_.sources(); ++source) {
      for (std::size_t j = 0; j < slopes_; ++j) {
        for (std::size_t i = 0; i < angles_; ++i) {
          const std::size_t here = instant * to_instant + source * to_source + j * row + i;
          if (i + 1 < angles_) pair(here, here + 1);
          if (j + 1 < slopes_) pair(here, here + row, false);
          if (source + 1 < grid_.sources()) pair(here, here + to_source);
          if (instant + 1 < instants_) pair(here, here + to_instant);
        }
      }
    }
  }
}

bool LitPixelMarker::adjacent_in_images(const Gap& gap) const {
  for (std::size_t c = 0; c < cameras_; ++c) {
    const std::size_t p = gap.from_index * cameras_ + c;
    const std::size_t q = gap.to_index * cameras_ + c;
    if (std::abs(buffers_.hits.column[p] - buffers_.hits.column[q]) > kMargin) return false;
    if (std::abs(buffers_.hits.row[p] - buffers_.hits.row[q]) > kMargin) return false;
  }
  return true;
}

bool LitPixelMarker::share_surface(const Gap& gap) const {
  const FanHit& from = buffers_.hits.hit[gap.from_index];
  const FanHit& to = buffers_.hits.hit[gap.to_index];
  constexpr float kParallel = 0.99f;
  if (gap.from.instant != gap.to.instant) {
    return from.shape == to.shape && std::abs(from.normal.dot(to.normal)) > kParallel;
  }
  constexpr double kFlat = 0.25;  // px: distance from the other's tangent plane
  const auto tolerance = static_cast<float>(kFlat * plan_.pixel_size);
  const Eigen::Vector3f step = to.point - from.point;
  return std::abs(step.dot(from.normal)) < tolerance && std::abs(step.dot(to.normal)) < tolerance;
}

LitPixelMarker::Relation LitPixelMarker::relate(const Gap& gap) const {
  const FanHit& from = buffers_.hits.hit[gap.from_index];
  const FanHit& to = buffers_.hits.hit[gap.to_index];
  if (!from.hit() && !to.hit()) return Relation::kDark;
  if (!from.hit() || !to.hit()) return Relation::kVoid;
  const bool same_surface = share_surface(gap);
  if (same_surface && beside_sheet(from, to)) return Relation::kDark;
  const float close = gap.across_sheet ? kCloseAcross : kCloseGap;
  bool in_view = false;
  for (std::size_t c = 0; c < cameras_; ++c) {
    const Camera& camera = plan_.settings.model.cameras[c];
    const std::size_t p = gap.from_index * cameras_ + c;
    const std::size_t q = gap.to_index * cameras_ + c;
    const float around = margin(c, p, q);
    if (beyond(buffers_.hits.column[p], buffers_.hits.column[q], camera.width_px, around)) continue;
    if (beyond(buffers_.hits.row[p], buffers_.hits.row[q], camera.height_px, around)) continue;
    in_view = true;
    const bool apart = std::abs(buffers_.hits.column[p] - buffers_.hits.column[q]) > close ||
                       std::abs(buffers_.hits.row[p] - buffers_.hits.row[q]) > close;
    if (apart) return same_surface ? Relation::kSteep : Relation::kVoid;
  }
  if (!in_view) return Relation::kDark;
  return same_surface ? Relation::kSameSurface : Relation::kEdge;
}

bool LitPixelMarker::should_subdivide(const Gap& gap, Relation relation) {
  if (gap.from.source != gap.to.source) return false;
  if (gap.from.instant != gap.to.instant) return gap.to.instant > gap.from.instant + 1;
  if (relation == Relation::kSteep) return gap.depth < kSteepDepth;
  return gap.depth < (relation == Relation::kVoid ? kVoidDepth : kEdgeDepth);
}

void LitPixelMarker::visit(const Gap& gap, std::vector<PixelMask>& masks) {
  const Relation relation = relate(gap);
  if (relation == Relation::kDark) return;
  if (relation != Relation::kSameSurface && should_subdivide(gap, relation)) {
    buffers_.gaps.push_back(gap);
  } else if (relation == Relation::kSameSurface || relation == Relation::kEdge) {
    if (gap.in_grid && adjacent_in_images(gap)) return;
    mark_between(gap.from_index, gap.to_index, masks);
  } else {
    mark_alone(gap.from_index, masks);
    mark_alone(gap.to_index, masks);
  }
}

void LitPixelMarker::refine(std::vector<PixelMask>& masks) {
  // The rays of a packet share an instant and a source: the gaps are sorted accordingly, keeping neighbours
  // together.
  std::stable_sort(buffers_.gaps.begin(), buffers_.gaps.end(), [](const Gap& a, const Gap& b) {
    return std::make_pair(a.from.instant + a.to.instant, a.from.source) <
           std::make_pair(b.from.instant + b.to.instant, b.from.source);
  });
  buffers_.middle.clear();
  buffers_.next_gaps.clear();
  for (const Gap& gap : buffers_.gaps) {
    const FanRay ray = FanRay::middle(gap.from, gap.to);
    while (buffers_.middle.size() % kLanes != 0 && !buffers_.middle.back().shares_packet_with(ray)) {
      buffers_.middle.push_back(buffers_.middle.back());
      buffers_.next_gaps.push_back(buffers_.next_gaps.back());
    }
    buffers_.middle.push_back(ray);
    buffers_.next_gaps.push_back(gap);
  }
  grid_.cast(buffers_.middle, buffers_.middle_hits);
  const std::size_t base = buffers_.hits.hit.size();
  buffers_.hits.append(buffers_.middle_hits);
  buffers_.gaps.clear();
  for (std::size_t k = 0; k < buffers_.middle.size(); ++k) {
    const Gap& gap = buffers_.next_gaps[k];
    visit({gap.from, buffers_.middle[k], gap.from_index, base + k, gap.depth + 1, gap.across_sheet}, masks);
    visit({buffers_.middle[k], gap.to, base + k, gap.to_index, gap.depth + 1, gap.across_sheet}, masks);
  }
}

float LitPixelMarker::margin(std::size_t camera, std::size_t p, std::size_t q) const {
  return kMargin + static_cast<float>(plan_.pixel_reach[camera]) +
         std::max(buffers_.hits.blur[p], buffers_.hits.blur[q]);
}

void LitPixelMarker::mark_between(std::size_t a, std::size_t b, std::vector<PixelMask>& masks) const {
  // Only the surface between the edges of the sheet is lit.
  const float from = buffers_.hits.hit[a].across;
  const float to = buffers_.hits.hit[b].across;
  float start = 0.0f;
  float end = 1.0f;
  if (std::abs(to - from) > 1e-6f) {
    const float low = (-kJustOutside - from) / (to - from);
    const float high = (kJustOutside - from) / (to - from);
    start = std::clamp(std::min(low, high), 0.0f, 1.0f);
    end = std::clamp(std::max(low, high), 0.0f, 1.0f);
  }
  for (std::size_t c = 0; c < cameras_; ++c) {
    const std::size_t p = a * cameras_ + c;
    const std::size_t q = b * cameras_ + c;
    const float columns = buffers_.hits.column[q] - buffers_.hits.column[p];
    const float rows = buffers_.hits.row[q] - buffers_.hits.row[p];
    const auto [left, right] =
        std::minmax({buffers_.hits.column[p] + start * columns, buffers_.hits.column[p] + end * columns});
    const auto [top, bottom] =
        std::minmax({buffers_.hits.row[p] + start * rows, buffers_.hits.row[p] + end * rows});
    const Camera& camera = plan_.settings.model.cameras[c];
    const float around = margin(c, p, q);
    if (beyond(left, right, camera.width_px, around) || beyond(top, bottom, camera.height_px, around))
      continue;
    masks[c].mark(static_cast<int>(std::lround(left - around)), static_cast<int>(std::lround(right + around)),
                  static_cast<int>(std::lround(top - around)),
                  static_cast<int>(std::lround(bottom + around)));
  }
}

void LitPixelMarker::mark_alone(std::size_t a, std::vector<PixelMask>& masks) const {
  if (in_sheet(buffers_.hits.hit[a])) mark_between(a, a, masks);
}

}  // namespace sensor_rt
