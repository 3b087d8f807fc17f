#include <gtest/gtest.h>

#include <algorithm>

#include "sensor_rt/render/lamps/block_grid.h"

namespace sensor_rt {
namespace {

TEST(BlockGridTest, InterpolationBetweenCornersReproducesLinearValues) {
  for (const int width : {1, 2, 7, 8, 9, 10, 15, 16, 17, 85, 160}) {
    const int height = width + 3;
    const BlockGrid<double> grid(width, height, [](int column, int row) { return 3.0 * column - 2.0 * row; });
    for (int row = 0; row < height; ++row) {
      for (int column = 0; column < width; ++column) {
        const double x = grid.place_of_column(column);
        const double y = grid.place_of_row(row);
        const int i = std::min(static_cast<int>(x), grid.columns() - 2);
        const int j = std::min(static_cast<int>(y), grid.rows() - 2);
        const double u = x - i;
        const double v = y - j;
        const double between = (1.0 - v) * ((1.0 - u) * grid.at(i, j) + u * grid.at(i + 1, j)) +
                               v * ((1.0 - u) * grid.at(i, j + 1) + u * grid.at(i + 1, j + 1));
        EXPECT_NEAR(between, 3.0 * column - 2.0 * row, 1e-12) << width << ": " << column << ", " << row;
      }
    }
  }
}

}  // namespace
}  // namespace sensor_rt
