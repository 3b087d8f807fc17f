#include "sensor_rt/render/photons/splat_image.h"

#include <algorithm>
#include <cmath>

namespace sensor_rt {

void SplatImage::reset(int width, int height) {
  for (int level = 0; level < kLevels; ++level) {
    const int cell = 1 << level;
    const int columns = (width + cell - 1) / cell + 2;
    const int rows = (height + cell - 1) / cell + 2;
    Grid& grid = grids_[level];
    const bool is_new = grid.cells.width() != columns || grid.cells.height() != rows;
    if (is_new || grid.used) grid.cells.resize(columns, rows);
    grid.used = false;
  }
}

void SplatImage::add(double column, double row, double amount, double size) {
  const int level =
      std::clamp(static_cast<int>(std::floor(std::log2(std::max(size / 1.5, 0.5)))) + 1, 0, kLevels - 1);
  Grid& grid = grids_[level];
  const ImageView<float> cells = grid.cells.view();
  const double cell = 1 << level;
  // Cell i of the grid, counted without the border, covers pixels [i * cell - 0.5, (i + 1) * cell - 0.5].
  const double x = (column + 0.5) / cell + 0.5;
  const double y = (row + 0.5) / cell + 0.5;
  grid.used = true;
  if (level == 0) {
    const int i = static_cast<int>(std::lround(column)) + 1;
    const int j = static_cast<int>(std::lround(row)) + 1;
    if (i >= 0 && i < cells.width && j >= 0 && j < cells.height) cells.at(j, i) += static_cast<float>(amount);
    return;
  }
  const double left = std::floor(x);
  const double top = std::floor(y);
  const double fx = x - left;
  const double fy = y - top;
  const int i = static_cast<int>(left);
  const int j = static_cast<int>(top);
  if (i < 0 || j < 0 || i + 1 >= cells.width || j + 1 >= cells.height) return;
  cells.at(j, i) += static_cast<float>(amount * (1.0 - fx) * (1.0 - fy));
  cells.at(j, i + 1) += static_cast<float>(amount * fx * (1.0 - fy));
  cells.at(j + 1, i) += static_cast<float>(amount * (1.0 - fx) * fy);
  cells.at(j + 1, i + 1) += static_cast<float>(amount * fx * fy);
}

void SplatImage::fold_border(const ImageView<float>& cells) {
  const auto fold = [](float& border, float& inside) {
    inside += border;
    border = 0.0f;
  };
  for (int y = 0; y < cells.height; ++y) {
    fold(cells.at(y, 0), cells.at(y, 1));
    fold(cells.at(y, cells.width - 1), cells.at(y, cells.width - 2));
  }
  for (int x = 0; x < cells.width; ++x) {
    fold(cells.at(0, x), cells.at(1, x));
    fold(cells.at(cells.height - 1, x), cells.at(cells.height - 2, x));
  }
  // Folded borders make the interpolation at the border as bright as in the adjacent cell.
  for (int y = 0; y < cells.height; ++y) {
    cells.at(y, 0) = cells.at(y, 1);
    cells.at(y, cells.width - 1) = cells.at(y, cells.width - 2);
  }
  for (int x = 0; x < cells.width; ++x) {
    cells.at(0, x) = cells.at(1, x);
    cells.at(cells.height - 1, x) = cells.at(cells.height - 2, x);
  }
}

void SplatImage::pass_down(Grid& coarse, Grid& fine) {
  fine.used = true;
  fold_border(coarse.cells.view());
  const ImageView<float> from = coarse.cells.view();
  const ImageView<float> to = fine.cells.view();
  for (int y = 1; y + 1 < to.height; ++y) {
    // Without borders: fine cell k lies in coarse cell k / 2, which contributes three quarters.
    const int near_row = (y - 1) / 2 + 1;
    const int far_row = std::clamp(near_row + ((y - 1) % 2 == 0 ? -1 : 1), 0, from.height - 1);
    const float* near = from.row(near_row);
    const float* far = from.row(far_row);
    float* out = to.row(y);
    for (int x = 1; x + 1 < to.width; ++x) {
      const int nx = (x - 1) / 2 + 1;
      const int fx = nx + ((x - 1) % 2 == 0 ? -1 : 1);
      out[x] += 0.25f *
                (0.75f * (0.75f * near[nx] + 0.25f * near[fx]) + 0.25f * (0.75f * far[nx] + 0.25f * far[fx]));
    }
  }
}

ImageView<const float> SplatImage::resolve() {
  for (int level = kLevels - 1; level > 0; --level) {
    if (grids_[level].used) pass_down(grids_[level], grids_[level - 1]);
  }
  const ImageView<float> cells = grids_[0].cells.view();
  return {cells.data + cells.stride + 1, cells.width - 2, cells.height - 2, cells.stride};
}

}  // namespace sensor_rt
