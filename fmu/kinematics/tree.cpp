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

std::size_t Tree::add(const Joint& joint) {
  const auto moves = [](const Isometry3d& pose) { return pose.matrix() != Isometry3d::Identity().matrix(); };
  const std::size_t number = nodes_.size();
  if (joint.parent >= number) {
    throw std::invalid_argument("joint " + std::to_string(number) + ": expected a parent before it");
  }
  paths_.push_back(paths_[joint.parent]);
  if (joint.kind != Joint::Kind::kFixed) paths_.back().push_back(number);
  carried_.push_back(carried_[joint.parent]);
  carried_.back().push_back(number);
  nodes_.push_back({joint, moves(joint.parent_from_joint), moves(joint.joint_from_frame)});
  return number;
}

std::size_t Tree::common(std::size_t frame, std::size_t other) const {
  const std::vector<std::size_t>&a = path(frame), &b = path(other);
  std::size_t count = 0;
  while (count < a.size() && count < b.size() && a[count] == b[count]) ++count;
  return count;
}

void Tree::advance(std::size_t number, const double* position, const double* rate,
                   const std::vector<Deviation>& deviations, Motion& motion) const {
  const Node& node = nodes_[number];
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
  placed.joints[kWorld] = placed.frames[kWorld] = Isometry3d::Identity();
  for (std::size_t i = 1; i < nodes_.size(); ++i) {
    const Node& node = nodes_[i];
    Isometry3d& pose = placed.joints[i];
    pose = placed.frames[node.joint.parent];
    if (node.displaced_before) pose = pose * node.joint.parent_from_joint;
    placed.frames[i] = node.joint.kind == Joint::Kind::kFixed ? pose : pose * moved(node.joint, position);
    if (node.displaced_behind) placed.frames[i] = placed.frames[i] * node.joint.joint_from_frame;
  }
}

std::vector<Motion> Tree::motions(const double* position, const double* rate,
                                  const std::vector<Deviation>& deviations) const {
  std::vector<Motion> frames(nodes_.size());
  for (std::size_t i = 1; i < nodes_.size(); ++i) {
    frames[i] = frames[nodes_[i].joint.parent];
    advance(i, position, rate, deviations, frames[i]);
  }
  return frames;
}

Motion Tree::frame(std::size_t frame, const double* position, const double* rate,
                   const std::vector<Deviation>& deviations) const {
  Motion motion;
  for (const std::size_t joint : carried_[frame]) advance(joint, position, rate, deviations, motion);
  return motion;
}

Eigen::Matrix<double, 6, 1> Tree::column(const PlacedTree& placed, std::size_t joint,
                                         const Vector3d& point) const {
  const Isometry3d& pose = placed.joints[joint];
  const Vector3d axis = pose.linear().col(2);
  Eigen::Matrix<double, 6, 1> column;
  if (nodes_[joint].joint.kind == Joint::Kind::kRevolute) {
    column << axis.cross(point - pose.translation()), axis;
  } else {
    column << axis, Vector3d::Zero();
  }
  return column;
}

}  // namespace robotcell
