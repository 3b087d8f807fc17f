#include "fmu/model/shaking.h"

namespace robotcell {
namespace {

/// A motion displaced along axes that stand still.
Motion displaced(const Motion& motion, const Eigen::Matrix3d& axes, const Displacement& by) {
  Motion sum = motion;
  sum.pose.pretranslate(axes * by.position);
  sum.velocity += axes * by.velocity;
  return sum;
}

}  // namespace

Shaking::Shaking(const CellDescription& cell, const AsBuilt& as_built, std::uint64_t key)
    : base_(as_built.base_vibration, "base", key + 1000),
      flange_(as_built.flange_vibration, "flange", key + 2000),
      table_(as_built.table_vibration, "table", key + 3000),
      table_axes_(cell.table.world_from_table.linear()) {}

Motion Shaking::base(const Motion& base, std::int64_t time_us) const {
  if (!base_.active()) return base;
  return displaced(base, base.pose.linear(), base_.at(time_us));
}

Motion Shaking::flange(const Motion& flange, std::int64_t time_us) const {
  if (!flange_.active()) return flange;
  const Displacement by = flange_.at(time_us);
  // The flange's own axes turn with it.
  const Motion shifted = attached(flange, Eigen::Isometry3d(Eigen::Translation3d(by.position)));
  return displaced(shifted, flange.pose.linear(), {Eigen::Vector3d::Zero(), by.velocity});
}

Motion Shaking::platter(const Motion& platter, std::int64_t time_us) const {
  if (!table_.active()) return platter;
  return displaced(platter, table_axes_, table_.at(time_us));
}

}  // namespace robotcell
