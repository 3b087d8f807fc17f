#include "fmu/kinematics/tree.h"

#include <stdexcept>
#include <string>

namespace robotcell {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

/// Motion of a frame that moves relative to a moving body.
Motion composed(const Motion& body, const Motion& relative) {
  Motion frame = attached(body, relative.pose);
  frame.velocity += body.pose.linear() * relative.velocity;
  frame.angular_velocity += body.pose.linear() * relative.angular_velocity;
  return frame;
}

/// Motion behind a joint that moves by `position` at a rate.
Motion moved(const Motion& joint, Joint::Kind kind, double position, double rate) {
  Motion frame = joint;
  const Vector3d axis = joint.pose.linear().col(2);
  if (kind == Joint::Kind::kRevolute) {
    frame.pose = joint.pose * Isometry3d(Eigen::AngleAxisd(position, Vector3d::UnitZ()));
    frame.angular_velocity += rate * axis;
  } else {
    frame = attached(joint, Isometry3d(Eigen::Translation3d(0, 0, position)));
    frame.velocity += rate * axis;
  }
  return frame;
}

}  // namespace

Motion attached(const Motion& body, const Isometry3d& body_from_frame) {
  Motion frame;
  frame.pose = body.pose * body_from_frame;
  frame.angular_velocity = body.angular_velocity;
  frame.velocity =
      body.velocity + body.angular_velocity.cross(body.pose.linear() * body_from_frame.translation());
  return frame;
}

Tree::Tree(std::vector<Joint> joints) : joints_(std::move(joints)), paths_(1) {
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    const Joint& joint = joints_[i];
    const bool moves = joint.kind != Joint::Kind::kFixed;
    if (joint.parent < kWorld || joint.parent >= static_cast<int>(i) || (moves && joint.axis < 0)) {
      throw std::invalid_argument("joint " + std::to_string(i) +
                                  ": expected a parent before it, and an axis");
    }
    paths_.push_back(path(joint.parent));
    if (moves) paths_.back().push_back(static_cast<int>(i));
  }
}

const std::vector<int>& Tree::path(int frame) const { return paths_[static_cast<std::size_t>(frame + 1)]; }

std::size_t Tree::common(int frame, int other) const {
  const std::vector<int>&a = path(frame), &b = path(other);
  std::size_t count = 0;
  while (count < a.size() && count < b.size() && a[count] == b[count]) ++count;
  return count;
}

Motion Tree::before_joint(int joint, const Motion& parent, const std::vector<Deviation>& deviations) const {
  const Motion nominal = attached(parent, joints_[static_cast<std::size_t>(joint)].parent_from_joint);
  for (const Deviation& deviation : deviations) {
    if (deviation.joint == joint) return composed(nominal, deviation.motion);
  }
  return nominal;
}

Motion Tree::behind_joint(int number, const Motion& before, const double* position,
                          const double* rate) const {
  const Joint& joint = joints_[static_cast<std::size_t>(number)];
  if (joint.kind == Joint::Kind::kFixed) return attached(before, joint.joint_from_frame);
  const double speed = rate == nullptr ? 0 : rate[joint.axis];
  return attached(moved(before, joint.kind, position[joint.axis], speed), joint.joint_from_frame);
}

void Tree::place(const double* position, const double* rate, const std::vector<Deviation>& deviations,
                 PlacedTree& placed) const {
  placed.joints.resize(joints_.size());
  placed.frames.resize(joints_.size());
  for (int i = 0; i < static_cast<int>(joints_.size()); ++i) {
    const auto k = static_cast<std::size_t>(i);
    const int parent = joints_[k].parent;
    placed.joints[k] = before_joint(
        i, parent == kWorld ? Motion() : placed.frames[static_cast<std::size_t>(parent)], deviations);
    placed.frames[k] = behind_joint(i, placed.joints[k], position, rate);
  }
}

Motion Tree::frame(int frame, const double* position, const double* rate,
                   const std::vector<Deviation>& deviations) const {
  if (frame == kWorld) return {};
  const Motion parent =
      this->frame(joints_[static_cast<std::size_t>(frame)].parent, position, rate, deviations);
  return behind_joint(frame, before_joint(frame, parent, deviations), position, rate);
}

Eigen::Matrix<double, 6, 1> Tree::column(const PlacedTree& placed, int joint, const Vector3d& point) const {
  const Isometry3d& pose = placed.joints[static_cast<std::size_t>(joint)].pose;
  const Vector3d axis = pose.linear().col(2);
  Eigen::Matrix<double, 6, 1> column;
  if (joints_[static_cast<std::size_t>(joint)].kind == Joint::Kind::kRevolute) {
    column << axis.cross(point - pose.translation()), axis;
  } else {
    column << axis, Vector3d::Zero();
  }
  return column;
}

}  // namespace robotcell
