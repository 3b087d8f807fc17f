// Data shared by the steps of the stripe extraction. Internal to imaging.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_rt/geometry/image.h"
#include "sensor_rt/imaging/extract.h"
#include "sensor_rt/imaging/speckle_noise.h"

namespace sensor_rt {

/// Noise of a pixel: variance = floor + gain * (signal above the background) + (pattern + speckle) * signal²,
/// all in DN.
struct PixelNoise {
  float background = 0.0f;      ///< level of the image in which stripes are searched
  float variance_floor = 0.0f;  ///< read noise and quantisation, DN²
  float dark_variance = 0.0f;   ///< the same without light of the stripe, where rounding need not vary, DN²
  float gain = 0.0f;            ///< DN per electron: shot noise has variance gain * signal
  float pattern = 0.0f;         ///< variance of the relative pixel sensitivities
  float saturation = 0.0f;      ///< larger values are ignored
  SpeckleNoise speckle;

  /// Returns the variance of a pixel `signal` above the background, without pattern and speckle, DN².
  double variance(double signal) const {
    constexpr double kDark = 0.5;  // DN
    const float floor = signal < kDark ? dark_variance : variance_floor;
    return static_cast<double>(floor) + static_cast<double>(gain) * std::max(0.0, signal);
  }

  /// Returns the relative variance of the light of a pixel in sums over the window, in which speckle is
  /// treated as independent between pixels.
  float relative_of_sums() const { return pattern + speckle.of_sums(); }
};

/// A run of rows in one column that may contain the stripe.
struct Candidate {
  int column = 0;
  int first_row = 0;  ///< rows above the threshold
  int last_row = 0;
  int lower_limit = 0;  ///< limits of the rows that belong to no other candidate
  int upper_limit = 0;
  float strength = 0.0f;          ///< largest sum over three neighbouring rows
  float row = 0.0f;               ///< first guess of the centre
  float width = 0.0f;             ///< first guess of the standard deviation of the recorded signal, px
  float flat_top = 0.0f;          ///< half length of the saturated rows if these are many, px
  bool has_halo = false;          ///< the signal beside the stripe would govern its moments
  float amplitude = 0.0f;         ///< first guess of the height, DN
  float light_variance = 0.0f;    ///< variance per pixel due to background light, DN²
  float background = 0.0f;        ///< level of the background, continued to row 0, DN
  float background_slope = 0.0f;  ///< DN per row
  std::uint32_t flags = 0;

  float background_at(int row) const { return background + background_slope * static_cast<float>(row); }
};

/// Centre and shape of a stripe in one column.
struct StripeFit {
  double row = 0.0;
  float amplitude = 0.0f;
  float width = 0.0f;
  float row_sigma = 0.0f;
  float asymmetry = 0.0f;
  float asymmetry_sigma = 0.0f;  ///< standard deviation of asymmetry from noise
  float residual = 0.0f;         ///< RMS misfit beyond the expected noise, relative to amplitude
  float residual_noise = 0.0f;   ///< expected noise, relative to amplitude
  std::uint32_t flags = 0;
};

using ImageRows = ImageView<const std::uint16_t>;

/// Rows within `reach` of a candidate's centre that belong to no other candidate.
struct RowWindow {
  int first = 0;
  int last = 0;
};
RowWindow window(const Candidate& candidate, float reach, int height);

/// Measures `count` candidates of one image; one function per PeakDetector.
using LocateFunction = void(ImageRows image, const PixelNoise& noise, const Candidate* candidates,
                            std::size_t count, StripeFit* fits);
LocateFunction locate_gaussian;
LocateFunction locate_centre_of_gravity;
LocateFunction locate_parabola;
LocateFunction locate_log_parabola;
LocateFunction locate_blais_rioux_4;
LocateFunction locate_blais_rioux_8;
LocateFunction locate_derivative_of_gaussian;
LocateFunction locate_steger;

/// Finds the candidates of all columns. Keeps its memory between images.
class CandidateFinder {
 public:
  /// Returns the candidates sorted by column, then row: runs of rows whose sum with both neighbours exceeds
  /// that of the background by `threshold` (DN), split where a dip between two maxima is significant. The sum
  /// over three rows suppresses single bright pixels. `bit_depth` determines the width of the sums. Limits
  /// are not set yet.
  std::vector<Candidate>& find(ImageRows image, const PixelNoise& noise, float threshold, int bit_depth);

 private:
  struct Run {
    int first_row = -1;  ///< -1: none
    int valley_row = 0;
    float highest = 0.0f;
    float valley = 0.0f;
  };

  template <typename Sum>
  void scan(ImageRows image, const PixelNoise& noise, float threshold);
  void visit(ImageRows image, const PixelNoise& noise, float level, int row, int block);
  void close(int column, int last_row, int block);
  void sort_by_column(int width);

  std::vector<Run> runs_;           // per column
  std::vector<int> runs_in_block_;  // number of open runs
  std::vector<Candidate> found_;
  std::vector<Candidate> sorted_;
  std::vector<int> starts_;
};

/// Divides the rows of each column among its candidates.
void set_limits(std::vector<Candidate>& candidates, int height);

/// Estimates centre, width and amplitude from the moments of the run; centre and width of a saturated stripe,
/// and of one whose moments are wider than a stripe may be, from its flanks.
void estimate_shape(ImageRows image, const PixelNoise& noise, float max_sigma, Candidate& candidate);

/// Sets the flags that depend on the shape of a peak.
void flag_shape(const ExtractionOptions& options, StripeFit& fit);

/// Sets the flags of the chosen peaks of an image (one per column, ascending, shapes assessed) that depend on
/// their neighbours.
void flag_neighbours(const ExtractionOptions& options, const std::vector<Candidate>& candidates,
                     std::vector<StripeFit>& fits);

}  // namespace sensor_rt
