#include "fmu/model/cell_vibration.h"

namespace robotcell {
namespace {

/// Displaces a motion along axes that do not rotate.
Motion displaced(const Motion& motion, const Eigen::Matrix3d& axes, const Displacement& displacement) {
  Motion sum = motion;
  sum.pose.pretranslate(axes * displacement.position);
  sum.velocity += axes * displacement.velocity;
  return sum;
}

}  // namespace

CellVibration::CellVibration(const CellDescription& cell, const AsBuilt& as_built, std::uint64_t key)
    : base_(as_built.base_vibration, "base", key + 1000),
      flange_(as_built.flange_vibration, "flange", key + 2000),
      table_(as_built.table_vibration, "table", key + 3000),
      table_axes_(cell.table.world_from_table.linear()) {}

Motion CellVibration::base(const Motion& base, std::int64_t time_us) const {
  if (!base_.active()) return base;
  return displaced(base, base.pose.linear(), base_.at(time_us));
}

Motion CellVibration::flange(const Motion& flange, std::int64_t time_us) const {
  if (!flange_.active()) return flange;
  const Displacement displacement = flange_.at(time_us);
  // The axes of the flange rotate with it.
  const Motion shifted = attached(flange, Eigen::Isometry3d(Eigen::Translation3d(displacement.position)));
  return displaced(shifted, flange.pose.linear(), {Eigen::Vector3d::Zero(), displacement.velocity});
}

Motion CellVibration::platter(const Motion& platter, std::int64_t time_us) const {
  if (!table_.active()) return platter;
  return displaced(platter, table_axes_, table_.at(time_us));
}

}  // namespace robotcell
