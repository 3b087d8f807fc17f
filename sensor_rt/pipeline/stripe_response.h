// Precomputed response of the extraction to a stripe, for the geometric engine.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "sensor_rt/geometry/lanes.h"
#include "sensor_rt/imaging/extract.h"
#include "sensor_rt/optics/camera.h"

namespace sensor_rt {

/// Standard deviation of the row, amplitude and flags that the extraction yields for straight Gaussian
/// stripes: it is run once on noise-free images of stripes of all heights and widths at several sub-pixel
/// positions, so that detector, threshold, saturation and noise model match those of images. The limits of
/// amplitude and width, and all effects of neighbouring columns, are left to the caller.
class StripeResponse {
 public:
  /// Response to sixteen stripes.
  struct alignas(64) Reading {
    float row_sigma[kLanes];  ///< px; 0: not found
    float amplitude[kLanes];  ///< DN
    float saturated[kLanes];  ///< fraction of the sub-pixel positions
  };

  /// `laser_off`: a background frame is subtracted. `background`: background light may add to the noise;
  /// otherwise `background_e` must be 0.
  StripeResponse(const ExtractionOptions& options, const ImageNoise& noise, const Camera& camera,
                 bool laser_off, bool background);

  /// Computes the response to stripes of given heights (DN, before pixel integration) and standard deviations
  /// (px) on uniform backgrounds (electrons per pixel) that are known except for their noise.
  void read(const float* height_dn, const float* width_px, const float* background_e, Reading& reading) const;

  /// Returns a shared instance for equal arguments; the last ones are cached.
  static std::shared_ptr<const StripeResponse> shared(const ExtractionOptions& options,
                                                      const ImageNoise& noise, const Camera& camera,
                                                      bool laser_off, bool background);

 private:
  /// Nodes in a geometric progression with four linear steps per octave: the position of a number follows
  /// from its bits.
  struct Axis {
    float first;
    int octaves;

    int nodes() const { return 4 * octaves + 1; }
    float node(int i) const;
    float last() const { return node(nodes() - 1); }
  };

  /// Positions on an axis: previous node, and fraction of the distance to the next.
  struct alignas(64) AxisPositions {
    std::int32_t index[kLanes];
    float share[kLanes];
  };

  /// Means over the sub-pixel positions; all but kFound are multiplied by the fraction of positions at which
  /// the stripe is found, so that they can be interpolated.
  struct alignas(16) Node {
    enum { kScaledSigma, kAmplitude, kSaturated, kFound, kValues };
    float v[kValues] = {};  ///< row_sigma times height and amplitude over height, which vary slowly
  };

  static Axis height_axis(const ImageNoise& noise);
  void fill(std::size_t level, const ExtractionOptions& options, const ImageNoise& noise,
            const Camera& camera, bool laser_off);
  static void find_positions(const Axis& axis, const float* values, AxisPositions& positions);
  Node mean(std::size_t level, const AxisPositions& height, const AxisPositions& width, int lane) const;
  Node mean(double background_e, const AxisPositions& height, const AxisPositions& width, int lane) const;

  Axis height_;
  Axis width_;
  std::size_t per_level_;
  std::vector<double> background_e_;
  std::vector<Node> nodes_;  ///< [background][width][height]
};

}  // namespace sensor_rt
