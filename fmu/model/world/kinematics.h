// The tree of a cell: nominal geometry plus deviations.
#pragma once

#include <array>

#include "fmu/kinematics/tree.h"
#include "fmu/model/as_built.h"
#include "fmu/model/bodies.h"
#include "fmu/model/description/cell_description.h"

namespace robotcell {

/// Kinematics of a cell.  The frames of its tree are the world, the base, the links (Denavit-Hartenberg
/// frames behind their joints), the flange, the sensor, what carries the table, and the rotating platter.
class Kinematics {
 public:
  Kinematics(const CellDescription& cell, const AsBuilt& as_built);

  std::size_t joints() const { return joints_; }
  const Tree& tree() const { return tree_; }
  static constexpr std::size_t kBase = 1;
  std::size_t link(std::size_t i) const { return kBase + 1 + i; }
  std::size_t flange() const { return link(joints_); }
  std::size_t sensor() const { return flange() + 1; }
  std::size_t table() const { return flange() + 2; }
  std::size_t platter() const { return flange() + 3; }

  const Eigen::Isometry3d& flange_from_sensor() const { return tree_[sensor()].joint_from_frame; }

  /// Motions of all frames at positions and rates of the axes, with displacements by vibration.
  std::vector<Motion> frames(const std::array<double, kAxes>& position, const std::array<double, kAxes>& rate,
                             const VibrationDisplacements& vibration = {}) const;
  /// Motion of one frame.
  Motion frame(std::size_t frame, const std::array<double, kAxes>& position,
               const std::array<double, kAxes>& rate, const VibrationDisplacements& vibration = {}) const;

 private:
  std::vector<Deviation> deviations(double table, double table_rate,
                                    const VibrationDisplacements& vibration) const;

  std::size_t joints_;
  TableWobble wobble_;
  Tree tree_;
};

/// Converts a motion to plain numbers.
BodyState body_state(const Motion& motion);

}  // namespace robotcell
