// Distribution of the dark signal of a pixel: dark current plus read noise.
#pragma once

#include "sensor_rt/detector/quantile_table.h"

namespace sensor_rt {

/// Returns the quantiles (electrons) of the sum of a Poisson number with mean `dark_e` and a normal number
/// with standard deviation `read_noise_e`, from the exact cumulative distribution. Requires read_noise_e > 0
/// unless dark_e = 0: a discrete distribution has no continuous quantiles.
QuantileTable dark_signal_table(double dark_e, double read_noise_e);

}  // namespace sensor_rt
