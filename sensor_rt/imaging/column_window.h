// Pixels around a candidate in its column, for detectors that work on single columns. Internal to imaging.
#pragma once

#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

constexpr int kWindowRows = 65;

/// Background-subtracted signal of several rows of one column, with its noise.
struct ColumnWindow {
  int first = 0;  ///< row of signal[0]
  int count = 0;
  double signal[kWindowRows];
  double variance[kWindowRows];
  bool clipped[kWindowRows];  ///< saturated

  double at(int i) const { return i >= 0 && i < count ? signal[i] : 0.0; }
};

/// Returns the rows within `reach` of the candidate's centre that belong to no other candidate.
ColumnWindow gather(ImageRows image, const PixelNoise& noise, const Candidate& candidate, double reach);

/// Returns the row of the highest pixel, or the centre of all clipped ones.
double summit(const ColumnWindow& window);

/// Sets width, height and skewness from the moments about the centre of gravity, and the flags.
void measure_moments(const ColumnWindow& window, const Candidate& candidate, StripeFit& fit);

/// Does the same in a window of three standard deviations to either side, which is returned.
ColumnWindow measure_moments(ImageRows image, const PixelNoise& noise, const Candidate& candidate,
                             StripeFit& fit);

/// Sets the row to `offset` rows from the start of the window, with its variance (px²). A row that is not
/// finite or outside the window is flagged as not converged and replaced by the first guess.
void set_row(const ColumnWindow& window, const Candidate& candidate, double offset, double variance,
             StripeFit& fit);

}  // namespace sensor_rt
