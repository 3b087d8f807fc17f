// Blur of laser light by the lens, applied to sharp images.
#pragma once

#include <vector>

#include "sensor_rt/optics/camera.h"
#include "sensor_rt/render/sparse_image.h"
#include "sensor_rt/render/stripe/stripe_image.h"

namespace sensor_rt {

/// Defocus and point spread function of one camera as a convolution, so that images are rendered by a
/// pinhole.
///
/// Light that comes straight from the laser lies in the sheet, hence a pixel determines its depth, and with
/// it the radius of the disc of defocus. The disc is that of a point: surfaces that occlude a part of the
/// lens are neglected, and so are differences of the image scale within the disc. Kernels have the exact
/// second moments; being symmetric, they keep the centre of a stripe.
class LensBlur {
 public:
  struct Buffers {
    ColumnImage spread;
    ColumnImage blurred;
    std::vector<float> column;
  };

  /// The camera's pose is in the frame of the sheet.
  explicit LensBlur(const Camera& camera);

  /// Whether the lens blurs the image of a camera.
  static bool is_needed(const Camera& camera) {
    return camera.has_depth_of_field() || camera.psf_sigma_px > 0.0;
  }

  /// Whether the convolution is accurate: a narrower point spread would show details between the pixels of a
  /// pinhole image, and on a tilted sensor out of focus discs are displaced. The camera's pose is in the
  /// frame of the sheet.
  static bool is_accurate(const Camera& camera);

  /// Returns the pinhole camera that renders the sharp image, with a margin from which light spreads into the
  /// image.
  Camera sharp_camera() const;

  /// Appends the image of the lens, times `scale`, to `out`, and clears that of the pinhole camera. The
  /// grains of speckle stay sharp.
  void apply(StripeImage& sharp, float scale, Buffers& buffers, SparseImage& out) const;

 private:
  /// Rows of one column of a disc: from row + start to row + end (edges of pixels), uniformly lit.
  struct Chord {
    int start;
    float start_share;
    int end;
    float end_share;
    float density;
  };
  struct Disc {
    int reach = 0;              ///< columns -reach .. reach
    std::vector<Chord> chords;  ///< by column
  };

  static Disc make_disc(double radius);
  const Disc& disc(int column, int row) const;
  void spread(ColumnImage& image, ColumnImage& out) const;
  void add_grains(ColumnImage& factors, ColumnImage& light) const;
  void convolve(ColumnImage& in, ColumnImage& out, std::vector<float>& column) const;

  Camera camera_;
  int margin_ = 0;               ///< px around the image
  int padding_ = 0;              ///< rows above and below the sharp image
  std::vector<double> defocus_;  ///< px, signed radius at the nodes of a grid over the sharp image
  int grid_columns_ = 0;
  double radius_step_ = 0.0;
  std::vector<Disc> discs_;      ///< by radius
  std::vector<float> gaussian_;  ///< from the centre outwards; a single 1 without point spread
};

}  // namespace sensor_rt
