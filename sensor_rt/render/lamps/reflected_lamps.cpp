#include "sensor_rt/render/lamps/reflected_lamps.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {
namespace {

constexpr int kPaths = 32;          ///< minimum number of paths per node
constexpr int kSmoothingNodes = 2;  ///< smoothing radius, nodes
constexpr double kSimilar = 0.9;    ///< smallest cosine between similar normals

bool is_similar(const LampView& a, const LampView& b) {
  return a.shape == b.shape && a.normal.dot(b.normal) > kSimilar;
}

}  // namespace

/// Traces a node: mean over several neighbouring pixels.
double ReflectedLamps::trace(int column, int row) const {
  const int pixels = std::max(1, (kPaths + samples_ - 1) / samples_);
  const int side = static_cast<int>(std::ceil(std::sqrt(pixels)));
  double sum = 0.0;
  for (int k = 0; k < pixels; ++k) {
    sum += tracer_.trace(std::min(column + k % side, camera_.width_px - 1),
                         std::min(row + k / side, camera_.height_px - 1));
  }
  return sum / pixels;
}

ReflectedLamps::ReflectedLamps(const RenderPlan& plan, const ExposureViews& views, std::size_t camera,
                               std::int64_t frame, const CentreTracer& direct)
    : camera_(plan.settings.model.cameras[camera]),
      samples_(static_cast<int>(plan.pattern.size())),
      tracer_(plan, PathTracer::Mode::kReflectedLamps, views, nullptr, camera, frame),
      nodes_(camera_.width_px, camera_.height_px, [&](int column, int row) {
        const LampView seen = direct.lamp_light(column, row);
        return Node{seen, seen.shape < 0 ? 0.0 : trace(column, row), 0.0};
      }) {
  for (int j = 0; j < nodes_.rows(); ++j) {
    for (int i = 0; i < nodes_.columns(); ++i) nodes_.at(i, j).light = smoothed(i, j);
  }
}

/// Returns the weighted mean of similar nodes nearby.
double ReflectedLamps::smoothed(int i, int j) const {
  const Node& middle = nodes_.at(i, j);
  double sum = 0.0;
  double weights = 0.0;
  for (int v = std::max(0, j - kSmoothingNodes); v <= std::min(nodes_.rows() - 1, j + kSmoothingNodes); ++v) {
    for (int u = std::max(0, i - kSmoothingNodes); u <= std::min(nodes_.columns() - 1, i + kSmoothingNodes);
         ++u) {
      const Node& node = nodes_.at(u, v);
      if (!is_similar(node.seen, middle.seen)) continue;
      const double weight = (kSmoothingNodes + 1 - std::abs(u - i)) * (kSmoothingNodes + 1 - std::abs(v - j));
      sum += weight * node.traced;
      weights += weight;
    }
  }
  return weights > 0.0 ? sum / weights : 0.0;
}

double ReflectedLamps::at(int column, int row, const LampView& seen) const {
  if (seen.shape < 0) return 0.0;
  const double x = nodes_.place_of_column(column);
  const double y = nodes_.place_of_row(row);
  // The four nearest nodes, then the twelve around them.
  for (const int reach : {1, 2}) {
    double sum = 0.0;
    double weights = 0.0;
    for (int j = static_cast<int>(y) + 1 - reach; j <= static_cast<int>(y) + reach; ++j) {
      for (int i = static_cast<int>(x) + 1 - reach; i <= static_cast<int>(x) + reach; ++i) {
        if (i < 0 || j < 0 || i >= nodes_.columns() || j >= nodes_.rows()) continue;
        const Node& node = nodes_.at(i, j);
        if (!is_similar(node.seen, seen)) continue;
        const double weight =
            std::max(0.0, 1.0 - std::abs(x - i) / reach) * std::max(0.0, 1.0 - std::abs(y - j) / reach);
        sum += weight * node.light;
        weights += weight;
      }
    }
    if (weights > 0.01) return sum / weights;
  }
  return trace(column, row);
}

}  // namespace sensor_rt
