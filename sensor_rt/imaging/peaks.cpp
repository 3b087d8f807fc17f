#include "sensor_rt/imaging/peaks.h"

namespace sensor_rt {
namespace {

template <typename T>
void extend(std::vector<T>& to, const std::vector<T>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

}  // namespace

void Peaks::clear() { *this = Peaks{}; }

void Peaks::append(const Peaks& other) {
  extend(frame, other.frame);
  extend(camera, other.camera);
  extend(column, other.column);
  extend(row, other.row);
  extend(amplitude, other.amplitude);
  extend(width, other.width);
  extend(row_sigma, other.row_sigma);
  extend(asymmetry, other.asymmetry);
  extend(residual, other.residual);
  extend(flags, other.flags);
}

}  // namespace sensor_rt
