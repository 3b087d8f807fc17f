// Vibration of robot base, flange and table, on top of their motion.
#pragma once

#include "fmu/model/cell_description.h"
#include "fmu/model/kinematics.h"
#include "fmu/model/vibration.h"

namespace robotcell {

/// Changes what is true, and nothing that anybody measures or that the dynamics engine feels: the
/// displacements are far too small to move what lies there.
class Shaking {
 public:
  /// Throws std::invalid_argument where a parameter makes no sense.
  Shaking(const CellDescription& cell, const AsBuilt& as_built, std::uint64_t key);

  /// Motions that stand for those without vibration: of the base, the flange (and all that it carries), the
  /// platter (likewise).
  Motion base(const Motion& base, std::int64_t time_us) const;
  Motion flange(const Motion& flange, std::int64_t time_us) const;
  Motion platter(const Motion& platter, std::int64_t time_us) const;

 private:
  Vibration base_, flange_, table_;
  Eigen::Matrix3d table_axes_;
};

}  // namespace robotcell
