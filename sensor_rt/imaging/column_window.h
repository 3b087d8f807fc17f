// The pixels around a candidate in its column, for detectors that work on one column. Internal to imaging.
#pragma once

#include "sensor_rt/imaging/stripe.h"

namespace sensor_rt {

constexpr int kWindowRows = 65;

/// Signal above the background of a few rows of one column, with its noise.
struct ColumnWindow {
  int first = 0;  ///< row of signal[0]
  int count = 0;
  double signal[kWindowRows];
  double variance[kWindowRows];
  bool clipped[kWindowRows];  ///< saturated

  double at(int i) const { return i >= 0 && i < count ? signal[i] : 0.0; }
};

/// Rows within `reach` of the candidate's centre that belong to it alone.
ColumnWindow gather(ImageRows image, const PixelNoise& noise, const Candidate& candidate, double reach);

/// Middle of the highest pixels: of all clipped ones, or the single highest.
double summit(const ColumnWindow& window);

/// Width, height and skewness of what is in the window about its centre of gravity, and the flags.
void describe(const ColumnWindow& window, const Candidate& candidate, StripeFit& fit);

/// Sets the row to `offset` rows from the window's first, with its variance (px²); a row that is not finite
/// or leaves the window counts as not converged and becomes the first guess.
void place(const ColumnWindow& window, const Candidate& candidate, double offset, double variance,
           StripeFit& fit);

}  // namespace sensor_rt
