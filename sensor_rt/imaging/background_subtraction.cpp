#include "sensor_rt/imaging/background_subtraction.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

SENSOR_RT_MULTIVERSION void subtract_row(const std::uint16_t* lit, const std::uint16_t* background, int width,
                                         int trusted, int pedestal, int shift, int marker,
                                         std::uint16_t* out) {
  for (int x = 0; x < width; ++x) {
    const int a = lit[x];
    const int b = background[x];
    const int value = std::min(std::max(a - b + pedestal, 0) >> shift, marker);
    out[x] = static_cast<std::uint16_t>((a > trusted) | (b > trusted) ? marker : value);
  }
}

}  // namespace

BackgroundSubtraction::BackgroundSubtraction(const ImageNoise& noise, float saturation) {
  constexpr int kPedestalBits = 3;  // an eighth of the range exceeds any noise
  trusted_ = static_cast<std::uint16_t>(std::max(0.0f, std::ceil(saturation) - 1.0f));
  pedestal_ = 1 << (noise.bit_depth - kPedestalBits);
  shift_ = noise.bit_depth > 15 ? 1 : 0;
  marker_ = ((1 << noise.bit_depth) - 1 + pedestal_) >> shift_;
  const double gain = noise.gain_dn_per_e / dn_per_count();
  const double read = gain * noise.read_noise_e;
  const double rounding = 1.0 / (12.0 * dn_per_count() * dn_per_count());
  // Half of the sums are odd and lose half a count.
  const double loss = shift_ > 0 ? 0.25 : 0.0;
  noise_.background = static_cast<float>((pedestal_ >> shift_) - loss);
  noise_.variance_floor = static_cast<float>(2.0 * (read * read + rounding) + loss * loss);
  noise_.gain = static_cast<float>(gain);
  noise_.pattern = static_cast<float>(noise.prnu * noise.prnu);
  noise_.saturation = static_cast<float>(marker_) - 0.25f;
}

ImageRows BackgroundSubtraction::subtract(ImageRows lit, ImageRows background) {
  if (lit.width != background.width || lit.height != background.height) {
    throw std::invalid_argument("image with the laser off: " + std::to_string(background.width) + " x " +
                                std::to_string(background.height) +
                                " pixels, the one with the laser on has " + std::to_string(lit.width) +
                                " x " + std::to_string(lit.height));
  }
  const auto width = static_cast<std::size_t>(lit.width);
  difference_.resize(width * static_cast<std::size_t>(lit.height));
  for (int y = 0; y < lit.height; ++y) {
    subtract_row(lit.row(y), background.row(y), lit.width, trusted_, pedestal_, shift_, marker_,
                 &difference_[static_cast<std::size_t>(y) * width]);
  }
  return {difference_.data(), lit.width, lit.height, lit.width};
}

void add_background_noise(ImageRows background, float black, float dn_per_count, const PixelNoise& noise,
                          double threshold_sigma, std::vector<Candidate>& candidates) {
  std::size_t kept = 0;
  for (Candidate& c : candidates) {
    const int first = std::max(0, c.first_row - 1);
    const int last = std::min(background.height - 1, c.last_row + 1);
    float light = 0.0f;
    for (int y = first; y <= last; ++y) light += static_cast<float>(background.at(y, c.column)) - black;
    light = std::max(0.0f, light / static_cast<float>(last - first + 1)) / dn_per_count;
    c.light_variance = 2.0f * noise.gain * light;
    const float deviation = std::sqrt(3.0f * (noise.variance_floor + c.light_variance));
    if (c.strength - 3.0f * noise.background > static_cast<float>(threshold_sigma) * deviation) {
      candidates[kept++] = c;
    }
  }
  candidates.resize(kept);
}

}  // namespace sensor_rt
