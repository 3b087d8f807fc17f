// Stripe centre as the centre of gravity of the background-subtracted signal. Unbiased on clean stripes, but
// biased by any other signal in the window.
#include <algorithm>

#include "sensor_rt/imaging/column_window.h"

namespace sensor_rt {

void locate_centre_of_gravity(ImageRows image, const PixelNoise& noise, const Candidate* candidates,
                              std::size_t count, StripeFit* fits) {
  for (std::size_t k = 0; k < count; ++k) {
    const Candidate& c = candidates[k];
    const ColumnWindow w = measure_moments(image, noise, c, fits[k]);
    double sum = 0.0;
    double moment = 0.0;
    for (int i = 0; i < w.count; ++i) {
      sum += w.signal[i];
      moment += w.signal[i] * i;
    }
    sum = std::max(sum, 1e-6);
    const double centre = std::clamp(moment / sum, 0.0, std::max(0.0, w.count - 1.0));
    double variance = 0.0;
    for (int i = 0; i < w.count; ++i) {
      variance += w.variance[i] * (i - centre) * (i - centre) / (sum * sum);
    }
    set_row(w, c, centre, variance, fits[k]);
  }
}

}  // namespace sensor_rt
