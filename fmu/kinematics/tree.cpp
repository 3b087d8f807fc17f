#include "fmu/kinematics/tree.h"

#include <stdexcept>
#include <string>

namespace robotcell {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

/// Goes on to a frame that is fixed to a moving body.
void attach(Motion& motion, const Isometry3d& body_from_frame) {
  motion.velocity += motion.angular_velocity.cross(motion.pose.linear() * body_from_frame.translation());
  motion.pose = motion.pose * body_from_frame;
}

/// Pose of a joint's frame relative to the joint, in front of its constant pose.
Isometry3d moved(const Joint& joint, const double* position) {
  const double by = position[joint.axis];
  if (joint.kind == Joint::Kind::kPrismatic) return Isometry3d(Eigen::Translation3d(0, 0, by));
  return Isometry3d(Eigen::AngleAxisd(by, Vector3d::UnitZ()));
}

}  // namespace

Motion attached(const Motion& body, const Isometry3d& body_from_frame) {
  Motion frame = body;
  attach(frame, body_from_frame);
  return frame;
}

Tree::Tree(std::vector<Joint> joints) : paths_(1) {
  const auto moves = [](const Isometry3d& pose) { return pose.matrix() != Isometry3d::Identity().matrix(); };
  for (Joint& joint : joints) {
    const int number = static_cast<int>(nodes_.size());
    const bool is_fixed = joint.kind == Joint::Kind::kFixed;
    if (joint.parent < kWorld || joint.parent >= number || (!is_fixed && joint.axis < 0)) {
      throw std::invalid_argument("joint " + std::to_string(number) +
                                  ": expected a parent before it, and an axis");
    }
    paths_.push_back(path(joint.parent));
    if (!is_fixed) paths_.back().push_back(number);
    carried_.push_back(joint.parent == kWorld ? std::vector<int>()
                                              : carried_[static_cast<std::size_t>(joint.parent)]);
    carried_.back().push_back(number);
    const bool before = moves(joint.parent_from_joint), behind = moves(joint.joint_from_frame);
    nodes_.push_back({std::move(joint), before, behind});
  }
}

const std::vector<int>& Tree::path(int frame) const { return paths_[static_cast<std::size_t>(frame + 1)]; }

std::size_t Tree::common(int frame, int other) const {
  const std::vector<int>&a = path(frame), &b = path(other);
  std::size_t count = 0;
  while (count < a.size() && count < b.size() && a[count] == b[count]) ++count;
  return count;
}

void Tree::advance(int number, const double* position, const double* rate,
                   const std::vector<Deviation>& deviations, Motion& motion) const {
  const Node& node = nodes_[static_cast<std::size_t>(number)];
  const Joint& joint = node.joint;
  if (node.displaced_before) attach(motion, joint.parent_from_joint);
  for (const Deviation& deviation : deviations) {
    if (deviation.joint != number) continue;
    const Eigen::Matrix3d axes = motion.pose.linear();
    attach(motion, deviation.motion.pose);
    motion.velocity += axes * deviation.motion.velocity;
    motion.angular_velocity += axes * deviation.motion.angular_velocity;
  }
  if (joint.kind != Joint::Kind::kFixed) {
    const Vector3d axis = motion.pose.linear().col(2);
    if (joint.kind == Joint::Kind::kRevolute) {
      motion.pose = motion.pose * moved(joint, position);
      motion.angular_velocity += rate[joint.axis] * axis;
    } else {
      attach(motion, moved(joint, position));
      motion.velocity += rate[joint.axis] * axis;
    }
  }
  if (node.displaced_behind) attach(motion, joint.joint_from_frame);
}

void Tree::place(const double* position, PlacedTree& placed) const {
  placed.joints.resize(nodes_.size());
  placed.frames.resize(nodes_.size());
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const Node& node = nodes_[i];
    const int parent = node.joint.parent;
    Isometry3d& pose = placed.joints[i];
    pose = parent == kWorld ? Isometry3d::Identity() : placed.frames[static_cast<std::size_t>(parent)];
    if (node.displaced_before) pose = pose * node.joint.parent_from_joint;
    placed.frames[i] = node.joint.kind == Joint::Kind::kFixed ? pose : pose * moved(node.joint, position);
    if (node.displaced_behind) placed.frames[i] = placed.frames[i] * node.joint.joint_from_frame;
  }
}

std::vector<Motion> Tree::motions(const double* position, const double* rate,
                                  const std::vector<Deviation>& deviations) const {
  std::vector<Motion> frames(nodes_.size());
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const int parent = nodes_[i].joint.parent;
    if (parent != kWorld) frames[i] = frames[static_cast<std::size_t>(parent)];
    advance(static_cast<int>(i), position, rate, deviations, frames[i]);
  }
  return frames;
}

Motion Tree::frame(int frame, const double* position, const double* rate,
                   const std::vector<Deviation>& deviations) const {
  Motion motion;
  if (frame == kWorld) return motion;
  for (const int joint : carried_[static_cast<std::size_t>(frame)]) {
    advance(joint, position, rate, deviations, motion);
  }
  return motion;
}

Eigen::Matrix<double, 6, 1> Tree::column(const PlacedTree& placed, int joint, const Vector3d& point) const {
  const Isometry3d& pose = placed.joints[static_cast<std::size_t>(joint)];
  const Vector3d axis = pose.linear().col(2);
  Eigen::Matrix<double, 6, 1> column;
  if (nodes_[static_cast<std::size_t>(joint)].joint.kind == Joint::Kind::kRevolute) {
    column << axis.cross(point - pose.translation()), axis;
  } else {
    column << axis, Vector3d::Zero();
  }
  return column;
}

}  // namespace robotcell
