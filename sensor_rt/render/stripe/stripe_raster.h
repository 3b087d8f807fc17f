// Image of the stripe from the mesh of the lit surface.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/render/emitter/speckle.h"
#include "sensor_rt/render/stripe/column_image.h"
#include "sensor_rt/render/stripe/laser_mesh.h"

namespace sensor_rt {

/// Integrates the light of a mesh over the pixels of one camera.
///
/// Lines along the rows of the image, two in a column (Gauss-Legendre nodes) or sixteen where there is an
/// edge, cut the quadrilaterals. On such a segment position, distance from the centre of the sheet, and light
/// are linear, so that the Gaussian profile of the sheet is integrated over each pixel by quadrature.
class StripeRaster {
 public:
  /// All must outlive it. `speckle`: null where the light has none.
  StripeRaster(const RenderPlan& plan, const LaserMesh& mesh, const StripeSamples& samples,
               std::size_t camera, const Speckle* speckle);

  /// Adds the light of sample `sample`, electrons per second, times the share of each row.
  void draw(std::size_t sample, const std::vector<float>& row_shares, ColumnImage& image) const;

 private:
  class PieceAdder;

  /// Point where a line meets an edge of a quadrilateral: `share` of the way along it.
  struct Crossing {
    double row, across, light;
    int edge;
    double share;
  };

  /// Part of a line within a quadrilateral, with ascending rows.
  struct Segment {
    int column;
    double line;    ///< px
    double weight;  ///< of the line in its column
    Crossing from, to;
  };

  void draw_quad(const LaserMesh::Quad& quad, std::size_t sample, const std::vector<float>& row_shares,
                 ColumnImage& image, PieceAdder& adder) const;
  void draw_segment(const LaserMesh::Quad& quad, const Segment& segment, std::size_t sample,
                    const std::vector<float>& row_shares, ColumnImage& image, PieceAdder& adder) const;
  Eigen::Vector3d point(const LaserMesh::Quad& quad, const Crossing& crossing) const;

  const LaserMesh& mesh_;
  const PoseTrack& track_;
  std::size_t camera_;
  const Speckle* speckle_;
  /// Points along the edge of a pixel at which the pattern is evaluated: fewer with more samples.
  int speckle_grid_;
  int width_;
  int height_;
  Eigen::Vector2d first_pixel_;  ///< px of the image with margin from that of the camera
};

}  // namespace sensor_rt
