#include "sensor_rt/render/stripe/stripe_raster.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sensor_rt/geometry/fast_math.h"
#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

constexpr int kEdgeLines = 16;  ///< lines in a column with an edge

/// Lines of a column, px from its centre.
struct Lines {
  int count = 0;
  std::array<double, kEdgeLines> offset{};
};

Lines gauss_lines() {
  const double node = 0.5 / std::sqrt(3.0);
  return {2, {-node, node}};
}

Lines even_lines() {
  Lines lines;
  for (int k = 0; k < kEdgeLines; ++k)
    lines.offset[static_cast<std::size_t>(k)] = (k + 0.5) / kEdgeLines - 0.5;
  lines.count = kEdgeLines;
  return lines;
}

/// Multiplies the light by the mean of e^(-x²/2) over each piece: Gauss-Legendre quadrature with four nodes.
SENSOR_RT_MULTIVERSION
void weigh(const float* __restrict start, const float* __restrict step, float* __restrict light) {
  constexpr float kNode[2] = {0.0694318442f, 0.3300094782f};
  constexpr float kWeight[2] = {0.1739274226f, 0.3260725774f};
  for (int l = 0; l < kLanes; ++l) {
    float sum = 0.0f;
    for (int k = 0; k < 2; ++k) {
      const float x = start[l] + kNode[k] * step[l];
      const float y = start[l] + (1.0f - kNode[k]) * step[l];
      sum += kWeight[k] * (exp_negative(-0.5f * x * x) + exp_negative(-0.5f * y * y));
    }
    light[l] *= sum;
  }
}

}  // namespace

/// Collects sixteen pieces of segments, each within a pixel, and adds their light to the image.
class StripeRaster::PieceAdder {
 public:
  explicit PieceAdder(StripeImage& image)
      : even_(image.even.column(0)), grainy_(image.has_speckle() ? image.grainy.column(0) : nullptr) {}

  /// `start`: distance from the centre of the sheet, standard deviations; `step`: its change; `light`: of the
  /// piece if it were at the centre of the sheet; `speckle`: factor of the pixel.
  void add(float start, float step, float light, float speckle, std::size_t pixel) {
    start_[count_] = start;
    step_[count_] = step;
    light_[count_] = light;
    speckle_[count_] = speckle;
    pixel_[count_] = pixel;
    if (++count_ == kLanes) finish();
  }
  void finish() {
    weigh(start_, step_, light_);
    for (int l = 0; l < count_; ++l) even_[pixel_[l]] += light_[l];
    for (int l = 0; l < count_ && grainy_ != nullptr; ++l) grainy_[pixel_[l]] += speckle_[l] * light_[l];
    count_ = 0;
  }

 private:
  alignas(64) float start_[kLanes] = {};
  alignas(64) float step_[kLanes] = {};
  alignas(64) float light_[kLanes] = {};
  alignas(64) float speckle_[kLanes] = {};
  std::size_t pixel_[kLanes] = {};
  int count_ = 0;
  float* even_;
  float* grainy_;  ///< null: no speckle
};

StripeRaster::StripeRaster(const RenderPlan& plan, const LaserMesh& mesh, const StripeSamples& samples,
                           std::size_t camera, const Speckle* speckle)
    : mesh_(mesh),
      samples_(samples),
      camera_(camera),
      speckle_(speckle),
      width_(plan.stripe_cameras[camera].optics.width_px),
      height_(plan.stripe_cameras[camera].optics.height_px),
      first_pixel_(plan.settings.model.cameras[camera].cx_px - plan.stripe_cameras[camera].optics.cx_px,
                   plan.settings.model.cameras[camera].cy_px - plan.stripe_cameras[camera].optics.cy_px) {}

void StripeRaster::draw(std::size_t sample, const std::vector<float>& row_shares, StripeImage& image) const {
  PieceAdder adder(image);
  Speckle::Cell cell;
  for (const LaserMesh::Quad& quad : mesh_.quads()) {
    const auto is_seen = [&](std::uint32_t k) {
      return mesh_.image(camera_, k).state == LaserMesh::State::kSeen;
    };
    if (!std::all_of(quad.corner.begin(), quad.corner.end(), is_seen)) continue;
    Speckle::Patch patch;
    if (speckle_ != nullptr) {
      const LaserMesh::Vertex& vertex = mesh_.vertex(quad.corner[0]);
      const Eigen::Vector3d travel = samples_.travel(vertex.shape, sample, vertex.point);
      patch = speckle_->patch(sample, vertex.shape, vertex.point, travel, cell);
    }
    draw_quad(quad, patch, row_shares, image, adder);
  }
  adder.finish();
}

void StripeRaster::draw_quad(const LaserMesh::Quad& quad, const Speckle::Patch& patch,
                             const std::vector<float>& row_shares, StripeImage& image,
                             PieceAdder& adder) const {
  static const Lines kCoarseLines = gauss_lines();
  static const Lines kFineLines = even_lines();
  std::array<const LaserMesh::Image*, 4> corners{};
  for (std::size_t k = 0; k < 4; ++k) corners[k] = &mesh_.image(camera_, quad.corner[k]);
  const auto [left, right] =
      std::minmax({corners[0]->column, corners[1]->column, corners[2]->column, corners[3]->column});
  const int first = std::max(0, static_cast<int>(std::floor(left + 0.5)));
  const int last = std::min(width_ - 1, static_cast<int>(std::floor(right + 0.5)));
  for (int column = first; column <= last; ++column) {
    const Lines& lines = mesh_.has_edge(camera_, column) ? kFineLines : kCoarseLines;
    for (int n = 0; n < lines.count; ++n) {
      const double at = column + lines.offset[static_cast<std::size_t>(n)];
      if (at < left || at >= right) continue;
      std::array<Crossing, 4> crossings;
      std::size_t count = 0;
      for (std::size_t k = 0; k < 4; ++k) {
        const std::size_t next = (k + 1) % 4;
        const LaserMesh::Image& a = *corners[k];
        const LaserMesh::Image& b = *corners[next];
        if ((a.column <= at) == (b.column <= at)) continue;
        const double t = (at - a.column) / (b.column - a.column);
        crossings[count++] = {a.row + t * (b.row - a.row), a.across + t * (b.across - a.across),
                              a.light + t * (b.light - a.light)};
      }
      if (count == 4) {  // a folded quadrilateral
        std::sort(crossings.begin(), crossings.end(),
                  [](const Crossing& a, const Crossing& b) { return a.row < b.row; });
      }
      for (std::size_t k = 0; k + 1 < count; k += 2) {
        const bool is_upwards = crossings[k].row <= crossings[k + 1].row;
        const Segment segment{column, 1.0 / lines.count, crossings[is_upwards ? k : k + 1],
                              crossings[is_upwards ? k + 1 : k]};
        draw_segment(segment, patch, row_shares, image, adder);
      }
    }
  }
}

void StripeRaster::draw_segment(const Segment& segment, const Speckle::Patch& patch,
                                const std::vector<float>& row_shares, StripeImage& image,
                                PieceAdder& adder) const {
  constexpr double kWidest = 2.0;  // standard deviations, of a piece
  const Crossing& a = segment.from;
  const Crossing& b = segment.to;
  const double length = b.row - a.row;
  if (!(length > 1e-12)) return;
  const double per_row = (b.across - a.across) / length;
  const double light_per_row = (b.light - a.light) / length;
  // The part within the sheet and within the image.
  double start = std::max(a.row, -0.5);
  double end = std::min(b.row, height_ - 0.5);
  if (std::max(std::abs(a.across), std::abs(b.across)) > kSheetReach) {
    if (per_row == 0.0) return;
    const double middle = a.row - a.across / per_row;
    const double reach = kSheetReach / std::abs(per_row);
    start = std::max(start, middle - reach);
    end = std::min(end, middle + reach);
  }
  if (!(start < end)) return;
  const int first = static_cast<int>(std::floor(start + 0.5));
  const int last = std::min(height_ - 1, static_cast<int>(std::floor(end + 0.5)));
  const std::size_t top = static_cast<std::size_t>(segment.column) * static_cast<std::size_t>(height_);
  image.touch(segment.column, first, last);
  const double widest = kWidest / std::max(std::abs(per_row), 1e-300);
  for (int row = first; row <= last; ++row) {
    const double lower = std::max(start, row - 0.5);
    const double height = std::min(end, row + 0.5) - lower;
    if (!(height > 0.0)) continue;
    const int pieces = height <= widest ? 1 : static_cast<int>(height / widest) + 1;
    const double step = height / pieces;
    const double share =
        segment.weight * step * static_cast<double>(row_shares[static_cast<std::size_t>(row)]);
    for (int piece = 0; piece < pieces; ++piece) {
      const double from_a = lower - a.row + piece * step;
      const double middle = from_a + 0.5 * step;
      const double value = share * (a.light + light_per_row * middle);
      const Eigen::Vector2d at(segment.column, a.row + middle);
      const float speckle = speckle_ != nullptr ? speckle_->over_pixel(first_pixel_ + at, patch) : 1.0f;
      adder.add(static_cast<float>(a.across + per_row * from_a), static_cast<float>(per_row * step),
                static_cast<float>(value), speckle, top + static_cast<std::size_t>(row));
    }
  }
}

}  // namespace sensor_rt
