// Image of the stripe from the mesh of the lit surface.
#pragma once

#include <cstddef>
#include <vector>

#include "sensor_rt/render/emitter/speckle.h"
#include "sensor_rt/render/stripe/laser_mesh.h"
#include "sensor_rt/render/stripe/stripe_image.h"

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
  void draw(std::size_t sample, const std::vector<float>& row_shares, StripeImage& image) const;

 private:
  class PieceAdder;

  /// Point where a line meets an edge of a quadrilateral.
  struct Crossing {
    double row, across, light;
  };

  /// Part of a line within a quadrilateral, with ascending rows.
  struct Segment {
    int column;
    double weight;  ///< of the line in its column
    Crossing from, to;
  };

  void draw_quad(const LaserMesh::Quad& quad, const Speckle::Patch& patch,
                 const std::vector<float>& row_shares, StripeImage& image, PieceAdder& adder) const;
  void draw_segment(const Segment& segment, const Speckle::Patch& patch, const std::vector<float>& row_shares,
                    StripeImage& image, PieceAdder& adder) const;

  const LaserMesh& mesh_;
  const StripeSamples& samples_;
  std::size_t camera_;
  const Speckle* speckle_;
  int width_;
  int height_;
  Eigen::Vector2d first_pixel_;  ///< px of the image with margin from that of the camera
};

}  // namespace sensor_rt
