// Vibration of robot base, flange and table, superimposed on their motion.
#pragma once

#include "fmu/model/description/cell_description.h"
#include "fmu/model/vibration.h"
#include "fmu/model/world/kinematics.h"

namespace robotcell {

/// Affects true poses only, neither encoder readings nor the dynamics: the displacements are too small to
/// move what lies there.
class CellVibration {
 public:
  /// Throws std::invalid_argument for invalid parameters.
  CellVibration(const CellDescription& cell, const AsBuilt& as_built, std::uint64_t key);

  /// Motions with vibration: of the base, of the flange and all it carries, and of the platter.
  Motion base(const Motion& base, std::int64_t time_us) const;
  Motion flange(const Motion& flange, std::int64_t time_us) const;
  Motion platter(const Motion& platter, std::int64_t time_us) const;

 private:
  Vibration base_, flange_, table_;
  Eigen::Matrix3d table_axes_;
};

}  // namespace robotcell
