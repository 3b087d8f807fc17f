// What a world holds of the dynamics engine: bodies, what can carry a part, and how friction holds parts.
#pragma once

#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/ShapeNode.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <dart/simulation/World.hpp>
#include <memory>
#include <unordered_map>
#include <vector>

#include "fmu/model/capped_collision_detector.h"
#include "fmu/model/dynamic_arm.h"
#include "fmu/model/gripper.h"
#include "fmu/model/soft_collision_detector.h"
#include "fmu/model/world.h"

namespace robotcell {

constexpr std::int32_t kNothing = -1;  // the number of no support: the world itself
constexpr std::int32_t kTableSupport = 0;

/// Whatever a free part can touch. The table is number 0, the belts follow, then the gripper's fingers, and
/// then all parts.
struct Support {
  std::string name;
  dart::dynamics::ShapeNode* shape = nullptr;  // null where nothing can touch it
  dart::dynamics::BodyNode* body = nullptr;
  double friction = 0;
  bool flat = false;  // a plane with the body's z axis as its normal
};

/// Contacts of a free part with one support, in the last step.
struct PairContact {
  std::int32_t support = 0;
  Eigen::Vector3d force = Eigen::Vector3d::Zero();   // on the part, world (N)
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // mean, towards the part, world
  ContactForce split;
  bool holds = false;  // friction does, and the part rests on the support
};

/// A part on a support that holds it, at the start of a step.
struct Ride {
  std::int32_t support = 0;
  Eigen::Isometry3d support_from_part = Eigen::Isometry3d::Identity();
  dart::math::Jacobian jacobian;  // of the support's body; none where that is a free part
};

struct Part {
  bool free = false;
  bool soft = false;
  PartPlace clamped;
  dart::dynamics::SkeletonPtr skeleton;  // of a free part
  double friction = 0;
  double gyration = 0;  // radius of gyration, m
  std::int32_t carrier = kNothing;
  std::vector<StickAnchor> anchors;
  std::vector<PairContact> contacts;
  std::vector<Ride> rides;
  Eigen::Isometry3d before = Eigen::Isometry3d::Identity();  // pose at the start of the step
  Eigen::Vector6d moved = Eigen::Vector6d::Zero();  // by the engine in the step: its twist times the time
  bool settled = false;                             // in the step that ends

  dart::dynamics::BodyNode* body() const { return skeleton->getBodyNode(0); }
  const Eigen::Isometry3d& pose() const { return body()->getWorldTransform(); }

  /// Contact with a support that holds; null where it does not.
  const PairContact* holding(std::int32_t support) const;
};

struct World::Engine {
  dart::simulation::WorldPtr world;
  std::shared_ptr<CappedCollisionDetector> detector;
  dart::dynamics::SkeletonPtr arm, table, ground;
  std::unique_ptr<DynamicArm> dynamic_arm;  // null where the drives are kinematic
  std::vector<dart::dynamics::SkeletonPtr> belts;
  std::vector<double> travel;        // of each belt, m
  std::unique_ptr<Gripper> gripper;  // null where the cell has none
  std::vector<Part> parts;
  std::vector<Support> supports;

  void add_support(const Support& support);
  /// Bounds the contacts of all shapes of one name with those of another.
  void set_most_contacts(const ContactPair& pair);
  /// Soft parts touch all that is not soft.
  void connect_soft_parts(SoftCollisionDetector& soft) const;
  static std::int32_t support_number(const StandsOn& stands_on);
  dart::dynamics::BodyNode* platter() const { return table->getBodyNode(0); }
  dart::dynamics::FreeJoint* table_joint() const {
    return static_cast<dart::dynamics::FreeJoint*>(table->getJoint(0));
  }

  /// Body and pose of what carries; the ground for kNothing. A belt's frame travels with its surface.
  dart::dynamics::BodyNode* body_of(std::int32_t support) const;
  Eigen::Isometry3d pose_of(std::int32_t support) const;
  Carrier carrier_of(std::int32_t support) const;

  /// The free part that a support is; null where it is none.
  Part* free_part(std::int32_t support);
  const Part* free_part(std::int32_t support) const;

  /// Forces of a finger's pad on all parts in the last step (N): along the contacts' normals, and whole.
  std::pair<double, Eigen::Vector3d> pad_force(std::size_t finger) const;

  /// Before a step: notes where the parts are on what holds them.
  void begin_step();

  /// After a step: reads what touches what, and puts back what friction holds.
  void hold_parts(double time_step);

  /// Throws std::invalid_argument when states are not of these parts.
  void check(const std::vector<FreePartState>& states) const;

 private:
  void read_contacts();
  void add_contact(std::int32_t on, std::int32_t by, const Eigen::Vector3d& force,
                   const Eigen::Vector3d& normal);
  void hold(Part& part, double time_step);
  void put_back(Part& part, double time_step) const;
  void take_hold(Part& part) const;
  Eigen::Isometry3d carried(const Part& part, const Ride& ride, double time_step) const;
  bool is_soft(std::int32_t support) const;
  void weigh_contacts(Part& part, double time_step);
  Eigen::Vector3d slip_of(const Part& part, const PairContact& contact) const;
  double spin_of(const Part& part, const PairContact& contact) const;

  std::unordered_map<const dart::dynamics::ShapeFrame*, std::int32_t> support_of_shape_;
};

}  // namespace robotcell
