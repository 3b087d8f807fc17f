#include "sensor_rt/scene/sight.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

constexpr int kWide = EightBoxes::kCount;
/// Room for rounding, of single precision's 6e-8, relative to what is computed.
constexpr float kSlack = 1e-5f;

struct EightWindows {
  alignas(32) float low[Window::kAxes][kWide];
  alignas(32) float high[Window::kAxes][kWide];
};

struct Frame {
  const float* eye;
  const float (*axes)[3];
  float slack;
  float depth;
};

/// Bounds of the boxes across and along, divided by depth, and in depth; `in_front` is 1 where some of the
/// box lies between the eye and the depth.
SENSOR_RT_MULTIVERSION
void project_boxes(const Frame& frame, const EightBoxes& __restrict boxes, EightWindows& __restrict windows,
                   float* __restrict in_front) {
  float middle[3][kWide];
  float reach[3][kWide];
  for (int i = 0; i < 3; ++i) {
    const float* axis = frame.axes[i];
    for (int l = 0; l < kWide; ++l) {
      float at = 0.0f;
      float half = 0.0f;
      for (int k = 0; k < 3; ++k) {
        at += axis[k] * (0.5f * (boxes.low[k][l] + boxes.high[k][l]) - frame.eye[k]);
        half += std::abs(axis[k]) * (0.5f * (boxes.high[k][l] - boxes.low[k][l]));
      }
      middle[i][l] = at;
      reach[i][l] = half + frame.slack + kSlack * std::abs(at);
    }
  }
  float* near = windows.low[2];
  float* far = windows.high[2];
  for (int l = 0; l < kWide; ++l) {
    const float first = middle[0][l] - reach[0][l];
    const float last = middle[0][l] + reach[0][l];
    in_front[l] = (first < frame.depth) & (last > 0.0f) ? 1.0f : 0.0f;
    near[l] = first > frame.slack ? first : frame.slack;
    far[l] = last < frame.depth ? last : frame.depth;
  }
  for (int k = 0; k < 2; ++k) {
    for (int l = 0; l < kWide; ++l) {
      const float low = middle[k + 1][l] - reach[k + 1][l];
      const float high = middle[k + 1][l] + reach[k + 1][l];
      const float lowest = low / (low < 0.0f ? near[l] : far[l]);
      const float highest = high / (high > 0.0f ? near[l] : far[l]);
      windows.low[k][l] = lowest - kSlack * (1.0f + std::abs(lowest));
      windows.high[k][l] = highest + kSlack * (1.0f + std::abs(highest));
    }
  }
}

SENSOR_RT_MULTIVERSION
void overlap(const EightWindows& __restrict windows, const Window& window, float* __restrict meets) {
  for (int l = 0; l < kWide; ++l) {
    const bool across = (windows.low[0][l] <= window.high[0]) & (windows.high[0][l] >= window.low[0]);
    const bool along = (windows.low[1][l] <= window.high[1]) & (windows.high[1][l] >= window.low[1]);
    meets[l] = across & along ? meets[l] : 0.0f;
  }
}

/// Counts in steps of kStep: the widest vector.
constexpr int kStep = 16;

SENSOR_RT_MULTIVERSION
bool any_overlap(const float (*__restrict low)[Windows::kMost],
                 const float (*__restrict high)[Windows::kMost], int count, const Window& window) {
  alignas(64) int hits[kStep] = {};
  for (int first = 0; first < count; first += kStep) {
    for (int l = 0; l < kStep; ++l) {
      const int i = first + l;
      const bool across = (low[0][i] <= window.high[0]) & (high[0][i] >= window.low[0]);
      const bool along = (low[1][i] <= window.high[1]) & (high[1][i] >= window.low[1]);
      const bool deep = (low[2][i] <= window.high[2]) & (high[2][i] >= window.low[2]);
      hits[l] |= across & along & deep ? 1 : 0;
    }
  }
  int any = 0;
  for (int l = 0; l < kStep; ++l) any |= hits[l];
  return any != 0;
}

/// Places in the picture of an eye.
struct alignas(64) LanePlaces {
  float across[kLanes];
  float along[kLanes];
  float depth[kLanes];  ///< infinite for what does not lie before the eye: of that nothing is known
};

SENSOR_RT_MULTIVERSION
void place(const double* __restrict towards, float sign, const double* __restrict across,
           const double* __restrict along, LanePlaces& __restrict places) {
  for (int l = 0; l < kLanes; ++l) {
    const float depth = sign * static_cast<float>(towards[l]);
    const float scale = 1.0f / depth;
    places.across[l] = static_cast<float>(across[l]) * scale;
    places.along[l] = static_cast<float>(along[l]) * scale;
    places.depth[l] = depth > 0.0f ? depth : Window::kInfinity;
  }
}

/// Sets within[lane] to 1 where a way to there overlaps one of the windows.
SENSOR_RT_MULTIVERSION
void find_within(const float (*__restrict low)[Windows::kMost],
                 const float (*__restrict high)[Windows::kMost], int count,
                 const LanePlaces& __restrict places, int* __restrict within) {
  for (int i = 0; i < count; ++i) {
    for (int l = 0; l < kLanes; ++l) {
      const bool across = (low[0][i] <= places.across[l]) & (high[0][i] >= places.across[l]);
      const bool along = (low[1][i] <= places.along[l]) & (high[1][i] >= places.along[l]);
      const bool known = places.depth[l] < Window::kInfinity;
      within[l] |= (across & along & (low[2][i] <= places.depth[l])) | !known ? 1 : 0;
    }
  }
}

/// Window around points whose depth is `sign` times `towards`.
SENSOR_RT_MULTIVERSION
void bound(const double* __restrict towards, float sign, const double* __restrict across,
           const double* __restrict along, const double* __restrict used, Window& __restrict window) {
  constexpr float kInfinity = Window::kInfinity;
  alignas(64) float least[5][kLanes];  // of across, along, their negatives, -depth
  for (int l = 0; l < kLanes; ++l) {
    const float depth = sign * static_cast<float>(towards[l]);
    const float scale = 1.0f / depth;
    const float y = static_cast<float>(across[l]) * scale;
    const float z = static_cast<float>(along[l]) * scale;
    // Of a point that does not lie before the eye nothing is known, of one that is not used nothing is asked.
    const float instead = used[l] > 0.0 ? -kInfinity : kInfinity;
    const bool in_picture = (used[l] > 0.0) & (depth > 0.0f);
    least[0][l] = in_picture ? y : instead;
    least[1][l] = in_picture ? z : instead;
    least[2][l] = in_picture ? -y : instead;
    least[3][l] = in_picture ? -z : instead;
    least[4][l] = in_picture ? -depth : instead;
  }
  for (int half = kLanes / 2; half > 0; half /= 2) {
    for (int b = 0; b < 5; ++b) {
      for (int l = 0; l < half; ++l) {
        least[b][l] = least[b][l] < least[b][l + half] ? least[b][l] : least[b][l + half];
      }
    }
  }
  window = {{least[0][0], least[1][0], least[0][0] <= -least[2][0] ? 0.0f : kInfinity},
            {-least[2][0], -least[3][0], -least[4][0]}};
}

}  // namespace

Window window_of(const Lanes3& way, ViewAxes axes, const double* used) {
  Window window;
  if (axes == ViewAxes::kZ) {
    bound(way.z, 1.0f, way.y, way.x, used, window);
  } else {
    bound(way.x, axes == ViewAxes::kX ? 1.0f : -1.0f, way.y, way.z, used, window);
  }
  return window;
}

void Windows::clear() {
  count_ = 0;
  frame_ = Window();
}

void Windows::add(const Window& window) {
  if (count_ % kStep == 0) {
    // What fills up the last step meets nothing.
    for (int k = 0; k < Window::kAxes; ++k) {
      std::fill_n(&low_[k][count_], kStep, Window::kInfinity);
      std::fill_n(&high_[k][count_], kStep, -Window::kInfinity);
    }
  }
  for (int k = 0; k < Window::kAxes; ++k) {
    low_[k][count_] = window.low[k];
    high_[k][count_] = window.high[k];
  }
  ++count_;
  frame_.include(window);
}

void Windows::narrow(const Lanes3& way, ViewAxes axes, int* open) const {
  LanePlaces places;
  if (axes == ViewAxes::kZ) {
    place(way.z, 1.0f, way.y, way.x, places);
  } else {
    place(way.x, axes == ViewAxes::kX ? 1.0f : -1.0f, way.y, way.z, places);
  }
  alignas(64) int within[kLanes] = {};
  find_within(low_, high_, count_, places, within);
  for (int l = 0; l < kLanes; ++l) open[l] = within[l] != 0 ? open[l] : 0;
}

bool Windows::meet(const Window& window) const { return any_overlap(low_, high_, count_, window); }

Sight::Sight(const Rigid3& shape_from_reference, const Eigen::Vector3d& eye_in_reference, ViewAxes axes,
             const Windows& bundles)
    : bundles_(bundles) {
  const Eigen::Vector3d eye = shape_from_reference * eye_in_reference;
  const Eigen::Matrix3d& rotation = shape_from_reference.rotation;
  const int depth = axes == ViewAxes::kZ ? 2 : 0;
  const double sign = axes == ViewAxes::kBackX ? -1.0 : 1.0;
  for (int k = 0; k < 3; ++k) {
    eye_[k] = static_cast<float>(eye[k]);
    axes_[0][k] = static_cast<float>(sign * rotation(k, depth));
    axes_[1][k] = static_cast<float>(rotation(k, 1));
    axes_[2][k] = static_cast<float>(rotation(k, 2 - depth));
  }
  slack_ = kSlack * static_cast<float>(eye.norm());
}

unsigned Sight::see(const EightBoxes& boxes, unsigned those, Window* windows) const {
  EightWindows seen;
  alignas(32) float in_sight[kWide];
  const Window& frame = bundles_.frame();
  project_boxes({eye_, axes_, slack_, frame.high[2] * (1.0f + kSlack)}, boxes, seen, in_sight);
  overlap(seen, frame, in_sight);
  unsigned bits = 0;
  for (int l = 0; l < kWide; ++l) {
    if ((those >> l & 1u) == 0 || !(in_sight[l] > 0.0f)) continue;
    windows[l] = {{seen.low[0][l], seen.low[1][l], seen.low[2][l]},
                  {seen.high[0][l], seen.high[1][l], seen.high[2][l]}};
    if (bundles_.meet(windows[l])) bits |= 1u << l;
  }
  return bits;
}

}  // namespace sensor_rt
