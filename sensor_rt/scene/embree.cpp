#include "sensor_rt/scene/embree.h"

#include <new>
#include <stdexcept>
#include <string>

namespace sensor_rt {
namespace {

struct Device {
  RTCDevice handle = rtcNewDevice("threads=1,set_affinity=0");
  Device() {
    if (handle == nullptr) throw std::runtime_error("cannot initialise Embree: no device");
  }
  ~Device() { rtcReleaseDevice(handle); }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;
};

}  // namespace

RTCDevice shared_device() {
  static const Device device;
  return device.handle;
}

void check_device(const char* action) {
  const RTCError error = rtcGetDeviceError(shared_device());
  if (error == RTC_ERROR_NONE) return;
  if (error == RTC_ERROR_OUT_OF_MEMORY) throw std::bad_alloc();
  throw std::runtime_error(std::string("Embree failed to ") + action + " (error " + std::to_string(error) +
                           ")");
}

}  // namespace sensor_rt
