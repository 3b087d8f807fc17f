// Parts of the cell; the first is the scanned part.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "fmu/model/description/frame_numbers.h"
#include "fmu/model/description/hull.h"
#include "fmu/model/description/rigid_inertia.h"

namespace robotcell {

class JsonReader;

/// Compliance of a soft part.
struct SoftDescription {
  double stiffness = 0;      // N/m, of each surface point towards the core, in every direction
  double damping_ratio = 0;  // of the points' oscillation
  double longest_edge = 0;   // m, maximum distance of neighbouring points
};

struct PartDescription {
  std::string name;
  bool free = false;                    // held by gravity and friction instead of clamped
  std::size_t stands_on = kWorld;       // frame, at the start
  Eigen::Isometry3d support_from_part;  // at the start
  double friction = 0;
  std::optional<SoftDescription> soft;  // empty: a rigid part
  RigidInertia inertial;                // part frame; zero for a clamped part without inertia
  Hull hull;                            // part frame; empty for a clamped part without contact shape
};

/// Limitations of a cell with soft parts, as text for the log; empty without soft parts.
std::string soft_part_warning(const std::vector<PartDescription>& parts);

/// Throws DescriptionError.
PartDescription parse_part(const JsonReader& json, const FrameNumbers& frames);

}  // namespace robotcell
