// Narrow spectral bands.
#pragma once

#include <cmath>

namespace sensor_rt {

/// Gaussian emission spectrum of a light, or Gaussian transmission of a filter; wavelengths in metres.
struct Band {
  double centre = 0.0;
  double width = 0.0;  ///< full width at half maximum

  /// Transmission of the filter at a wavelength, relative to its peak.
  double transmission(double wavelength) const {
    const double off = (wavelength - centre) / width;
    return std::exp(-kFourLnTwo * off * off);
  }

  /// Fraction of light with this spectrum that passes a filter of peak transmission 1.
  double passed_share(const Band& filter) const {
    const double width2 = width * width + filter.width * filter.width;
    const double off = centre - filter.centre;
    return filter.width / std::sqrt(width2) * std::exp(-kFourLnTwo * off * off / width2);
  }

 private:
  static constexpr double kFourLnTwo = 2.772588722239781;
};

}  // namespace sensor_rt
