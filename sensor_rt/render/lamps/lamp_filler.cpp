#include "sensor_rt/render/lamps/lamp_filler.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "sensor_rt/render/lamps/block_grid.h"

namespace sensor_rt {
namespace {

constexpr double kFlat = 1.0 - 1e-9;  // cosine between normals of one face
constexpr double kSmooth = 0.005;     // largest relative interpolation error at the centre
constexpr double kMaxRange = 0.2;     // largest relative difference between corners

bool on_one_face(const LampView& a, const LampView& b) {
  return a.shape == b.shape && (a.shape < 0 || a.normal.dot(b.normal) > kFlat);
}

struct Block {
  int left, top, right, bottom;  ///< corner pixels; the right and bottom ones belong to the next blocks
};

/// Fills a block by interpolation. Returns false when its light is not smooth; `trace` returns the light in a
/// pixel.
template <typename Trace>
bool interpolate(const Trace& trace, const Block& block, const LampView* const* corners, int width,
                 float* out) {
  double least = corners[0]->light;
  double most = least;
  for (int k = 1; k < 4; ++k) {
    if (!on_one_face(*corners[0], *corners[k])) return false;
    least = std::min(least, corners[k]->light);
    most = std::max(most, corners[k]->light);
  }
  if (most - least > kMaxRange * most) return false;
  const double across = std::max(1, block.right - block.left);
  const double down = std::max(1, block.bottom - block.top);
  const auto between = [&](int column, int row) {
    const double u = (column - block.left) / across;
    const double v = (row - block.top) / down;
    return (1.0 - v) * ((1.0 - u) * corners[0]->light + u * corners[1]->light) +
           v * ((1.0 - u) * corners[2]->light + u * corners[3]->light);
  };
  const int column = (block.left + block.right) / 2;
  const int row = (block.top + block.bottom) / 2;
  const LampView middle = trace(column, row);
  if (!on_one_face(*corners[0], middle) ||
      std::abs(middle.light - between(column, row)) > kSmooth * middle.light)
    return false;
  for (int y = block.top; y < block.top + kBlock && y <= block.bottom; ++y) {
    for (int x = block.left; x < block.left + kBlock && x <= block.right; ++x)
      out[static_cast<std::ptrdiff_t>(y) * width + x] = static_cast<float>(between(x, y));
  }
  return true;
}

}  // namespace

void fill_lamps(const CentreTracer& tracer, const ReflectedLamps* reflected, int width, int height,
                float* out) {
  const auto trace = [&](int column, int row) {
    LampView view = tracer.lamp_light(column, row);
    if (reflected != nullptr) view.light += reflected->at(column, row, view);
    return view;
  };
  const BlockGrid<LampView> grid(width, height, trace);
  for (int j = 0; j + 1 < grid.rows(); ++j) {
    for (int i = 0; i + 1 < grid.columns(); ++i) {
      const Block block{i * kBlock, j * kBlock, std::min((i + 1) * kBlock, width - 1),
                        std::min((j + 1) * kBlock, height - 1)};
      const LampView* const corners[] = {&grid.at(i, j), &grid.at(i + 1, j), &grid.at(i, j + 1),
                                         &grid.at(i + 1, j + 1)};
      if (interpolate(trace, block, corners, width, out)) continue;
      for (int y = block.top; y < std::min(block.top + kBlock, height); ++y) {
        for (int x = block.left; x < std::min(block.left + kBlock, width); ++x)
          out[static_cast<std::ptrdiff_t>(y) * width + x] = static_cast<float>(trace(x, y).light);
      }
    }
  }
}

}  // namespace sensor_rt
