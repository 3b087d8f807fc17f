// Detector without a description: its parameters are checked. Noise and quantisation: test_detector.py.
#include <gtest/gtest.h>

#include "sensor_rt/detector/detector.h"

namespace sensor_rt {
namespace {

TEST(Detector, ParametersOutOfRangeAreRejected) {
  DetectorParameters valid;
  valid.exposure = 5e-4;
  valid.quantum_efficiency = 0.5;
  valid.full_well_e = 11'000.0;
  valid.gain_dn_per_e = 0.3;
  valid.bit_depth = 12;
  EXPECT_NO_THROW(Detector(valid, true, 1));
  DetectorParameters wrong = valid;
  wrong.bit_depth = 7;
  EXPECT_THROW(Detector(wrong, true, 1), std::invalid_argument);
  wrong = valid;
  wrong.full_well_e = 0.0;
  EXPECT_THROW(Detector(wrong, true, 1), std::invalid_argument);
}

}  // namespace
}  // namespace sensor_rt
