#include "sensor_rt/scene/shaft_culler.h"

#include <algorithm>
#include <cmath>

#include "sensor_rt/geometry/multiversion.h"

namespace sensor_rt {
namespace {

constexpr int kWide = Aabb8::kCount;
/// Relative tolerance for rounding in single precision (6e-8).
constexpr float kSlack = 1e-5f;

struct ProjectedBounds8 {
  alignas(32) float low[ProjectedBounds::kAxes][kWide];
  alignas(32) float high[ProjectedBounds::kAxes][kWide];
};

struct Frame {
  const float* viewpoint;
  const float (*axes)[3];
  float slack;
  float depth;
};

/// Computes the projected bounds of the boxes; `in_front` is 1 where a box overlaps the depth range from the
/// viewpoint to `frame.depth`.
SENSOR_RT_MULTIVERSION
void project_boxes(const Frame& frame, const Aabb8& __restrict boxes, ProjectedBounds8& __restrict bounds,
                   float* __restrict in_front) {
  float middle[3][kWide];
  float reach[3][kWide];
  for (int i = 0; i < 3; ++i) {
    const float* axis = frame.axes[i];
    for (int l = 0; l < kWide; ++l) {
      float at = 0.0f;
      float half = 0.0f;
      for (int k = 0; k < 3; ++k) {
        at += axis[k] * (0.5f * (boxes.low[k][l] + boxes.high[k][l]) - frame.viewpoint[k]);
        half += std::abs(axis[k]) * (0.5f * (boxes.high[k][l] - boxes.low[k][l]));
      }
      middle[i][l] = at;
      reach[i][l] = half + frame.slack + kSlack * std::abs(at);
    }
  }
  float* near = bounds.low[2];
  float* far = bounds.high[2];
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
      bounds.low[k][l] = lowest - kSlack * (1.0f + std::abs(lowest));
      bounds.high[k][l] = highest + kSlack * (1.0f + std::abs(highest));
    }
  }
}

SENSOR_RT_MULTIVERSION
void overlap(const ProjectedBounds8& __restrict boxes, const ProjectedBounds& bounds,
             float* __restrict overlapping) {
  for (int l = 0; l < kWide; ++l) {
    const bool across = (boxes.low[0][l] <= bounds.high[0]) & (boxes.high[0][l] >= bounds.low[0]);
    const bool along = (boxes.low[1][l] <= bounds.high[1]) & (boxes.high[1][l] >= bounds.low[1]);
    overlapping[l] = across & along ? overlapping[l] : 0.0f;
  }
}

/// Number of bounds tested together: the widest vector.
constexpr int kStep = 16;

SENSOR_RT_MULTIVERSION
bool any_overlap(const float (*__restrict low)[ProjectedBoundsSet::kCapacity],
                 const float (*__restrict high)[ProjectedBoundsSet::kCapacity], int count,
                 const ProjectedBounds& bounds) {
  alignas(64) int hits[kStep] = {};
  for (int first = 0; first < count; first += kStep) {
    for (int l = 0; l < kStep; ++l) {
      const int i = first + l;
      const bool across = (low[0][i] <= bounds.high[0]) & (high[0][i] >= bounds.low[0]);
      const bool along = (low[1][i] <= bounds.high[1]) & (high[1][i] >= bounds.low[1]);
      const bool deep = (low[2][i] <= bounds.high[2]) & (high[2][i] >= bounds.low[2]);
      hits[l] |= across & along & deep ? 1 : 0;
    }
  }
  int any = 0;
  for (int l = 0; l < kStep; ++l) any |= hits[l];
  return any != 0;
}

/// Image coordinates as seen from a viewpoint.
struct alignas(64) LanePlaces {
  float across[kLanes];
  float along[kLanes];
  float depth[kLanes];  ///< infinite for points behind the viewpoint, which are treated as unknown
};

SENSOR_RT_MULTIVERSION
void place(const double* __restrict towards, float sign, const double* __restrict across,
           const double* __restrict along, LanePlaces& __restrict places) {
  for (int l = 0; l < kLanes; ++l) {
    const float depth = sign * static_cast<float>(towards[l]);
    const float scale = 1.0f / depth;
    places.across[l] = static_cast<float>(across[l]) * scale;
    places.along[l] = static_cast<float>(along[l]) * scale;
    places.depth[l] = depth > 0.0f ? depth : ProjectedBounds::kInfinity;
  }
}

/// Sets within[lane] to 1 where one of the bounds contains the point or the point is behind the viewpoint.
SENSOR_RT_MULTIVERSION
void find_within(const float (*__restrict low)[ProjectedBoundsSet::kCapacity],
                 const float (*__restrict high)[ProjectedBoundsSet::kCapacity], int count,
                 const LanePlaces& __restrict places, int* __restrict within) {
  for (int i = 0; i < count; ++i) {
    for (int l = 0; l < kLanes; ++l) {
      const bool across = (low[0][i] <= places.across[l]) & (high[0][i] >= places.across[l]);
      const bool along = (low[1][i] <= places.along[l]) & (high[1][i] >= places.along[l]);
      const bool known = places.depth[l] < ProjectedBounds::kInfinity;
      within[l] |= (across & along & (low[2][i] <= places.depth[l])) | !known ? 1 : 0;
    }
  }
}

/// Computes the bounds of points whose depth is `sign` times `towards`.
SENSOR_RT_MULTIVERSION
void bound(const double* __restrict towards, float sign, const double* __restrict across,
           const double* __restrict along, const double* __restrict used,
           ProjectedBounds& __restrict bounds) {
  constexpr float kInfinity = ProjectedBounds::kInfinity;
  alignas(64) float least[5][kLanes];  // minima of across, along, their negatives, and -depth
  for (int l = 0; l < kLanes; ++l) {
    const float depth = sign * static_cast<float>(towards[l]);
    const float scale = 1.0f / depth;
    const float y = static_cast<float>(across[l]) * scale;
    const float z = static_cast<float>(along[l]) * scale;
    // Points behind the viewpoint make the bounds infinite; unused lanes are ignored.
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
  bounds = {{least[0][0], least[1][0], least[0][0] <= -least[2][0] ? 0.0f : kInfinity},
            {-least[2][0], -least[3][0], -least[4][0]}};
}

}  // namespace

ProjectedBounds projected_bounds(const Lanes3& to_point, ViewAxes axes, const double* used) {
  ProjectedBounds bounds;
  if (axes == ViewAxes::kZ) {
    bound(to_point.z, 1.0f, to_point.y, to_point.x, used, bounds);
  } else {
    bound(to_point.x, axes == ViewAxes::kX ? 1.0f : -1.0f, to_point.y, to_point.z, used, bounds);
  }
  return bounds;
}

void ProjectedBoundsSet::clear() {
  count_ = 0;
  frame_ = ProjectedBounds();
}

void ProjectedBoundsSet::add(const ProjectedBounds& bounds) {
  if (count_ % kStep == 0) {
    // Padding of the last step overlaps nothing.
    for (int k = 0; k < ProjectedBounds::kAxes; ++k) {
      std::fill_n(&low_[k][count_], kStep, ProjectedBounds::kInfinity);
      std::fill_n(&high_[k][count_], kStep, -ProjectedBounds::kInfinity);
    }
  }
  for (int k = 0; k < ProjectedBounds::kAxes; ++k) {
    low_[k][count_] = bounds.low[k];
    high_[k][count_] = bounds.high[k];
  }
  ++count_;
  frame_.include(bounds);
}

void ProjectedBoundsSet::narrow(const Lanes3& to_point, ViewAxes axes, int* open) const {
  LanePlaces places;
  if (axes == ViewAxes::kZ) {
    place(to_point.z, 1.0f, to_point.y, to_point.x, places);
  } else {
    place(to_point.x, axes == ViewAxes::kX ? 1.0f : -1.0f, to_point.y, to_point.z, places);
  }
  alignas(64) int within[kLanes] = {};
  find_within(low_, high_, count_, places, within);
  for (int l = 0; l < kLanes; ++l) open[l] = within[l] != 0 ? open[l] : 0;
}

bool ProjectedBoundsSet::overlaps(const ProjectedBounds& bounds) const {
  return any_overlap(low_, high_, count_, bounds);
}

ShaftCuller::ShaftCuller(const Rigid3& shape_from_reference, const Eigen::Vector3d& viewpoint_in_reference,
                         ViewAxes axes, const ProjectedBoundsSet& bundles)
    : bundles_(bundles) {
  const Eigen::Vector3d viewpoint = shape_from_reference * viewpoint_in_reference;
  const Eigen::Matrix3d& rotation = shape_from_reference.rotation;
  const int depth = axes == ViewAxes::kZ ? 2 : 0;
  const double sign = axes == ViewAxes::kBackX ? -1.0 : 1.0;
  for (int k = 0; k < 3; ++k) {
    viewpoint_[k] = static_cast<float>(viewpoint[k]);
    axes_[0][k] = static_cast<float>(sign * rotation(k, depth));
    axes_[1][k] = static_cast<float>(rotation(k, 1));
    axes_[2][k] = static_cast<float>(rotation(k, 2 - depth));
  }
  slack_ = kSlack * static_cast<float>(viewpoint.norm());
}

unsigned ShaftCuller::cull(const Aabb8& boxes, unsigned mask, ProjectedBounds* bounds) const {
  ProjectedBounds8 seen;
  alignas(32) float in_shaft[kWide];
  const ProjectedBounds& frame = bundles_.frame();
  project_boxes({viewpoint_, axes_, slack_, frame.high[2] * (1.0f + kSlack)}, boxes, seen, in_shaft);
  overlap(seen, frame, in_shaft);
  unsigned bits = 0;
  for (int l = 0; l < kWide; ++l) {
    if ((mask >> l & 1u) == 0 || !(in_shaft[l] > 0.0f)) continue;
    bounds[l] = {{seen.low[0][l], seen.low[1][l], seen.low[2][l]},
                 {seen.high[0][l], seen.high[1][l], seen.high[2][l]}};
    if (bundles_.overlaps(bounds[l])) bits |= 1u << l;
  }
  return bits;
}

}  // namespace sensor_rt
