// Bodies of a world in the dynamics engine, supports of parts, and stick constraints.
#pragma once

#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/ShapeNode.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <dart/simulation/World.hpp>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include "fmu/model/capped_collision_detector.h"
#include "fmu/model/contact_filter.h"
#include "fmu/model/dynamic_arm.h"
#include "fmu/model/gripper.h"
#include "fmu/model/soft_collision_detector.h"
#include "fmu/model/world.h"

namespace robotcell {

constexpr std::int32_t kNoSupport = -1;  // no support; also the number of the stationary environment
constexpr std::int32_t kTableSupport = 0;

/// A body that can be in contact, and so support a free part. Number 0 is the table, then the belts, the
/// gripper's fingers, links and other bodies of the cell, and all parts.
struct Support {
  std::string name;
  dart::dynamics::ShapeNode* shape = nullptr;  // null where nothing can touch it
  dart::dynamics::BodyNode* body = nullptr;
  double friction = 0;
  bool flat = false;  // the top face is a plane normal to the body's z axis
};

/// Sum of the contacts of a free part with one support in the last step.
struct PairContact {
  std::int32_t support = 0;
  Eigen::Vector3d force = Eigen::Vector3d::Zero();   // N, on the part, world axes
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // mean, towards the part, world axes
  ContactForce split;
  bool sticks = false;  // within the friction cone and at rest on the support
};

/// Pose of a part relative to a support on which it sticks, at the start of a step.
struct SupportPose {
  std::int32_t support = 0;
  Eigen::Isometry3d support_from_part = Eigen::Isometry3d::Identity();
  dart::math::Jacobian jacobian;  // of the support's body; empty where that is a free part
};

struct Part {
  bool free = false;
  bool soft = false;
  PartPlacement clamped;
  dart::dynamics::SkeletonPtr skeleton;  // null for a clamped part
  double friction = 0;
  double radius_of_gyration = 0;  // m
  std::int32_t main_support = kNoSupport;
  std::vector<StickConstraint> stick_constraints;
  std::vector<PairContact> contacts;
  std::vector<SupportPose> support_poses;
  Eigen::Isometry3d before = Eigen::Isometry3d::Identity();  // pose at the start of the step
  Eigen::Vector6d displacement =
      Eigen::Vector6d::Zero();  // integrated by the engine in the step: twist times time step
  bool updated = false;         // stick constraints already applied in this step

  dart::dynamics::BodyNode* body() const { return skeleton->getBodyNode(0); }
  const Eigen::Isometry3d& pose() const { return body()->getWorldTransform(); }

  /// Sticking contact with a support; null if there is none.
  const PairContact* sticking_contact(std::int32_t support) const;
};

struct World::Engine {
  dart::simulation::WorldPtr world;
  std::shared_ptr<CappedCollisionDetector> detector;
  std::shared_ptr<ContactFilter> filter;
  dart::dynamics::SkeletonPtr arm, table, ground;
  std::unique_ptr<DynamicArm> dynamic_arm;  // null with kinematic drives
  std::vector<dart::dynamics::SkeletonPtr> belts;
  std::vector<double> travel;        // m, of each belt
  std::unique_ptr<Gripper> gripper;  // null in a cell without gripper
  std::vector<Part> parts;
  std::vector<Support> supports;

  /// Whether any body moves by forces: a free part, the gripper, an arm with dynamic drives. Otherwise all
  /// poses are prescribed, and the engine need not step.
  bool has_free_motion() const;

  void add_support(const Support& support);
  /// Excludes contacts between bodies that are joined, that do not move by forces, or that share a body.
  void exclude_contacts();
  /// Limits or excludes the contacts between all shapes of two names.
  void apply(const ContactPair& pair);
  /// Excludes contacts between bodies, other than parts, that intersect in the present poses. Returns their
  /// names, except those of link 1 and the base that carries it.
  std::string exclude_intersecting_bodies();
  /// Registers soft parts, and everything else as their obstacles.
  void connect_soft_parts(SoftCollisionDetector& soft) const;
  static std::int32_t support_number(const StandsOn& stands_on);
  dart::dynamics::BodyNode* platter() const { return table->getBodyNode(0); }
  dart::dynamics::FreeJoint* table_joint() const {
    return static_cast<dart::dynamics::FreeJoint*>(table->getJoint(0));
  }

  /// Body and pose of a support; the environment for kNoSupport. The frame of a belt travels with its
  /// surface.
  dart::dynamics::BodyNode* body_of(std::int32_t support) const;
  Eigen::Isometry3d pose_of(std::int32_t support) const;
  SupportingBody supporting_body_of(std::int32_t support) const;

  /// The free part with this support number; null for other supports.
  Part* free_part(std::int32_t support);
  const Part* free_part(std::int32_t support) const;

  /// Force of a finger's pad on all parts in the last step (N): sum of normal forces, and total force vector.
  std::pair<double, Eigen::Vector3d> pad_force(std::size_t finger) const;

  /// Call before a step: records the poses of sticking parts relative to their supports.
  void begin_step();

  /// Call after a step: reads the contacts and projects sticking parts onto their stick constraints.
  void apply_stick_constraints(double time_step);

  /// Throws std::invalid_argument where the states belong to other parts.
  void check(const std::vector<FreePartState>& states) const;

 private:
  void read_contacts();
  void add_contact(std::int32_t on, std::int32_t by, const Eigen::Vector3d& force,
                   const Eigen::Vector3d& normal);
  void update_stick_constraints(Part& part, double time_step);
  void project_to_stick_constraint(Part& part, double time_step) const;
  void engage_stick_constraints(Part& part) const;
  Eigen::Isometry3d relative_pose_after_step(const Part& part, const SupportPose& support_pose,
                                             double time_step) const;
  bool is_soft(std::int32_t support) const;
  bool moves_by_forces(const Support& support) const;
  bool can_touch(const Support& a, const Support& b) const;
  /// Number of a body in the chain of links from the base, from 0; fingers follow the last link.
  static int number_in_chain(const dart::dynamics::BodyNode* body);
  void classify_contacts(Part& part, double time_step);
  Eigen::Vector3d slip_velocity(const Part& part, const PairContact& contact) const;
  double spin_rate(const Part& part, const PairContact& contact) const;

  std::unordered_map<const dart::dynamics::ShapeFrame*, std::int32_t> support_of_shape_;
};

}  // namespace robotcell
