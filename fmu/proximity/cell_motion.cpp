#include "fmu/proximity/cell_motion.h"

#include <algorithm>
#include <cmath>

namespace robotcell::proximity {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

Matrix3d about_z(double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  Matrix3d turn;
  turn << c, -s, 0, s, c, 0, 0, 0, 1;
  return turn;
}

}  // namespace

CellMotion::CellMotion(std::vector<ChainJoint> joints, const Isometry3d& world_from_base,
                       const Isometry3d& world_from_table, std::vector<CarriedBody> bodies,
                       const std::vector<Pair>& pairs)
    : joints_(std::move(joints)),
      world_from_base_(world_from_base),
      world_from_table_(world_from_table),
      bodies_(std::move(bodies)),
      length_{0.0} {
  for (const ChainJoint& joint : joints_) length_.push_back(length_.back() + std::hypot(joint.a, joint.d));
  for (const auto& [a, b] : pairs) {
    const CarriedBody &of_a = bodies_[a], &of_b = bodies_[b];
    MovingPair pair;
    pair.outer = of_a.carried > of_b.carried ? a : b;
    pair.first = std::min(of_a.carried, of_b.carried);
    pair.turns = of_a.on_table != of_b.on_table;
    pair.turning = of_a.on_table ? a : b;
    pairs_.push_back(pair);
  }
}

void CellMotion::place(const double* axes, CellFrames& frames) const {
  frames.links.resize(joints_.size() + 1);
  frames.bodies.resize(bodies_.size());
  frames.links[0] = world_from_base_;
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const ChainJoint& joint = joints_[i];
    const Matrix3d turn = about_z(axes[i] + joint.theta);
    Isometry3d step = Isometry3d::Identity();
    step.linear() = turn * joint.twist;
    step.translation() = joint.a * turn.col(0) + Vector3d(0, 0, joint.d);
    frames.links[i + 1] = frames.links[i] * step;
  }
  frames.table = world_from_table_;
  frames.table.linear() *= about_z(axes[joints_.size()]);
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    const CarriedBody& body = bodies_[i];
    const Isometry3d& from_body = body.carrier_from_body;
    const auto link = static_cast<std::size_t>(body.carried);
    frames.bodies[i] = body.on_table ? frames.table * from_body
                       : link > 0    ? frames.links[link] * from_body
                                     : from_body;
  }
}

Isometry3d CellMotion::place_tool(const double* axes, const Isometry3d& link_from_tool,
                                  Eigen::Matrix<double, 6, Eigen::Dynamic>& jacobian) const {
  CellFrames frames;
  place(axes, frames);
  const Isometry3d tool = frames.links.back() * link_from_tool;
  jacobian.resize(6, static_cast<Eigen::Index>(joints_.size()));
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const Vector3d axis = frames.links[i].linear().col(2);
    const Vector3d lever = tool.translation() - frames.links[i].translation();
    jacobian.col(static_cast<Eigen::Index>(i)) << axis.cross(lever), axis;
  }
  return tool;
}

// The table moves a point p of a body that it turns at dp = h z x (p - o), and leaves this line by at most
// half of h² times the distance of p from the axis.
RelativeMotion CellMotion::motion_by_table(const CellFrames& frames, std::size_t turning, double half,
                                           double slack) const {
  const CarriedBody& body = bodies_[turning];
  const Vector3d axis = frames.table.linear().col(2);
  RelativeMotion result;
  result.moving = turning;
  result.at = frames.table * body.centre;
  result.velocity = half * axis.cross(result.at - frames.table.translation());
  result.turn = half * axis;
  result.rest = (half * half / 2 + slack) * body.table_radius;
  const double straight = result.velocity.norm() + result.turn.norm() * body.radius;
  result.bound = std::min((std::abs(half) + slack) * body.table_radius, result.rest + straight);
  return result;
}

// Joints move a point p of the outer body at dp = sum of h_k z_k x (p - o_k) (z_k, o_k: axis of joint k, h_k:
// its rate), in which motions of several joints may cancel, plus half of the second derivative, in which
// joints j <= k appear as h_j z_j x (h_k z_k x (p - o_k)): at most |h_j h_k| times the distance of p from
// o_k.
RelativeMotion CellMotion::motion(const CellFrames& frames, std::size_t pair, const double* half,
                                  const double* slack) const {
  const MovingPair& moving = pairs_[pair];
  const std::size_t table = joints_.size();
  const CarriedBody& body = bodies_[moving.outer];
  RelativeMotion turned;
  if (moving.turns) turned = motion_by_table(frames, moving.turning, half[table], slack[table]);
  const double by_table =
      moving.turns ? (std::abs(half[table]) + slack[table]) * bodies_[moving.turning].table_radius : 0;
  RelativeMotion result;
  result.moving = moving.outer;
  result.rest = result.bound = by_table;
  if (body.carried == moving.first) return moving.turns ? turned : result;
  const auto first = static_cast<std::size_t>(moving.first);
  const auto last = static_cast<std::size_t>(body.carried);
  const Vector3d centre = result.at = frames.links[last] * body.centre;
  const double from_last = body.centre.norm();
  double before = 0;  // travel of the joints before joint k
  for (std::size_t k = first; k < last; ++k) before += std::abs(half[k]);
  double summed = 0, strayed = 0, second = 0;
  double beyond = 0;  // joints beyond joint k move the body towards its axis or away from it
  for (std::size_t k = last; k-- > first;) {
    const double travel = std::abs(half[k]);
    before -= travel;
    if (travel + slack[k] == 0) continue;
    const Isometry3d& frame = frames.links[k];
    const Vector3d axis = frame.linear().col(2), lever = centre - frame.translation();
    const Vector3d across = axis.cross(lever);
    const double reach = across.norm() + body.radius + beyond;
    summed += travel * reach;
    strayed += slack[k] * reach;
    result.velocity += half[k] * across;
    result.turn += half[k] * axis;
    second += travel * (lever.norm() + body.radius + beyond) * (travel + 2 * std::max(before, 0.0));
    beyond += (travel + slack[k]) * (length_[last] - length_[k] + from_last);
  }
  if (moving.turns && summed == 0) {  // the table moves alone
    turned.rest += strayed;
    turned.bound += strayed;
    return turned;
  }
  result.rest = by_table + strayed + second / 2;
  const double straight = result.velocity.norm() + result.turn.norm() * body.radius;
  result.bound = std::min(by_table + strayed + summed, result.rest + straight);
  return result;
}

}  // namespace robotcell::proximity
