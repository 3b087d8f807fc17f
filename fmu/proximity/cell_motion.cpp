#include "fmu/proximity/cell_motion.h"

#include <algorithm>
#include <cmath>

namespace robotcell::proximity {

using Eigen::Isometry3d;
using Eigen::Vector3d;

CellMotion::CellMotion(Tree tree, std::size_t axes, std::vector<CarriedBody> bodies,
                       const std::vector<Pair>& pairs)
    : tree_(std::move(tree)), axes_(axes), bodies_(std::move(bodies)) {
  const auto joints = [this](std::size_t body) { return tree_.path(bodies_[body].frame).size(); };
  for (const auto& [a, b] : pairs) {
    const bool ordered = joints(a) > joints(b);
    pairs_.push_back({ordered ? a : b, ordered ? b : a, tree_.common(bodies_[a].frame, bodies_[b].frame)});
  }
}

void CellMotion::place(const double* axes, CellFrames& frames) const {
  tree_.place(axes, frames.tree);
  frames.bodies.resize(bodies_.size());
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    frames.bodies[i] = frames.tree.frames[bodies_[i].frame] * bodies_[i].frame_from_body;
  }
}

Isometry3d CellMotion::place_tool(const double* axes, std::size_t frame, const Isometry3d& frame_from_tool,
                                  Eigen::Matrix<double, 6, Eigen::Dynamic>& jacobian) const {
  PlacedTree placed;
  tree_.place(axes, placed);
  const Isometry3d tool = placed.frames[frame] * frame_from_tool;
  jacobian.setZero(6, static_cast<Eigen::Index>(axes_));
  for (const std::size_t joint : tree_.path(frame)) {
    jacobian.col(static_cast<Eigen::Index>(tree_[joint].axis)) =
        tree_.column(placed, joint, tool.translation());
  }
  return tool;
}

// A joint k moves a point p of the body at h_k z_k x (p - o_k), or at h_k z_k where it slides (z_k, o_k: its
// axis, h_k: its rate); motions of several joints may cancel.  The point leaves this line by half of the
// second derivative at most, in which turning joints j <= k appear as h_j z_j x (h_k z_k x (p - o_k)): at
// most |h_j h_k| times the distance of p from the axis k, or |h_j h_k| where k slides.  Joints beyond k
// change this distance by at most as much as they move the centre.
RelativeMotion CellMotion::motion_of(const CellFrames& frames, std::size_t number, std::size_t common,
                                     const double* half, const double* slack) const {
  const CarriedBody& body = bodies_[number];
  const std::vector<std::size_t>& path = tree_.path(body.frame);
  RelativeMotion result;
  result.moving = number;
  if (path.size() == common) return result;
  const Isometry3d& carrier = frames.tree.frames[body.frame];
  const Vector3d centre = result.at = carrier * body.centre;
  double before = 0;  // rotation by the joints before joint k
  for (std::size_t k = common; k < path.size(); ++k) {
    const Joint& joint = tree_[path[k]];
    if (joint.kind == Joint::Kind::kRevolute) before += std::abs(half[joint.axis]);
  }
  double summed = 0, strayed = 0, second = 0;
  double beyond = 0;  // motion of the centre by joints beyond joint k
  for (std::size_t k = path.size(); k-- > common;) {
    const Joint& joint = tree_[path[k]];
    const bool turns = joint.kind == Joint::Kind::kRevolute;
    const double rate = half[joint.axis], travel = std::abs(rate), stray = slack[joint.axis];
    if (turns) before -= travel;
    if (travel + stray == 0) continue;
    const Isometry3d& pose = frames.tree.joints[path[k]];
    const Vector3d axis = pose.linear().col(2);
    const Vector3d across = turns ? Vector3d(axis.cross(centre - pose.translation())) : axis;
    const double from_axis = turns ? across.norm() : 1;
    double reach = from_axis;  // of a point, and of the centre
    if (turns) {
      reach += body.radius;
      if (k + 1 == path.size()) reach = std::min(reach, body.from_axis);
      reach += beyond;
      result.turn += rate * axis;
    }
    result.velocity += rate * across;
    summed += travel * reach;
    strayed += stray * reach;
    second += travel * reach * ((turns ? travel : 0) + 2 * std::max(before, 0.0));
    beyond += (travel + stray) * (turns ? from_axis + beyond : 1);
  }
  result.rest = strayed + second / 2;
  const double straight = result.velocity.norm() + result.turn.norm() * body.radius;
  result.bound = std::min(strayed + summed, result.rest + straight);
  return result;
}

RelativeMotion CellMotion::motion(const CellFrames& frames, std::size_t pair, const double* half,
                                  const double* slack) const {
  const MovingPair& moving = pairs_[pair];
  RelativeMotion of_a = motion_of(frames, moving.a, moving.common, half, slack);
  RelativeMotion of_b = motion_of(frames, moving.b, moving.common, half, slack);
  // The line of one of both counts, of the other one the bound.
  const bool first = !of_a.velocity.isZero(0) || !of_a.turn.isZero(0) || of_b.bound == 0;
  RelativeMotion &line = first ? of_a : of_b, &other = first ? of_b : of_a;
  line.rest += other.bound;
  line.bound += other.bound;
  return line;
}

}  // namespace robotcell::proximity
