// Bodies of a world in the dynamics engine, supports of parts, and contacts.
#pragma once

#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/ShapeNode.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <dart/simulation/World.hpp>
#include <memory>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "fmu/model/world/capped_collision_detector.h"
#include "fmu/model/world/contact_filter.h"
#include "fmu/model/world/coulomb_solver.h"
#include "fmu/model/world/dynamic_arm.h"
#include "fmu/model/world/gripper_body.h"
#include "fmu/model/world/soft_collision_detector.h"
#include "fmu/model/world/world.h"

namespace robotcell {

constexpr std::int32_t kNoSupport = -1;  // no support; also the number of the stationary environment

/// A body that can be in contact, and so support a free part. Number 0 is the table, then the belts, the
/// gripper's fingers, links and other bodies of the cell, and all parts.
struct Support {
  std::string name;
  dart::dynamics::ShapeNode* shape = nullptr;  // null where nothing can touch it
  dart::dynamics::BodyNode* body = nullptr;
  double friction = 0;
  bool flat = false;           // the top face is a plane normal to the body's z axis
  std::size_t frame = kWorld;  // what rests on it moves with this frame; meaningless for a free part
  Eigen::Vector3d travel = Eigen::Vector3d::Zero();  // m, of the surface, body frame
};

/// Body that carries a frame of the tree.
struct Carrier {
  dart::dynamics::BodyNode* body = nullptr;
  Eigen::Isometry3d body_from_frame = Eigen::Isometry3d::Identity();

  Eigen::Isometry3d pose() const { return body->getWorldTransform() * body_from_frame; }
};

/// Sum of the contacts of a free part with one support in the last step.
struct PairContact {
  std::int32_t support = 0;
  Eigen::Vector3d force = Eigen::Vector3d::Zero();   // N, on the part, world axes
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  // mean, towards the part, world axes
  ContactForce split;
  bool sticks =
      false;  // set by the stick constraints: friction holds, and the part is at rest on the support
};

/// Force of one contact point on a free part in the last step (world axes).
struct PointContact {
  std::int32_t on = 0, by = 0;                      // support numbers of the part and of the other body
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // m, world
  Eigen::Vector3d force = Eigen::Vector3d::Zero();  // N
};

/// A part in the dynamics engine. Its state (FreePartState) is that of the skeleton, the main support and the
/// stick constraint; contacts are those of the last step.
struct Part {
  bool free = false;
  bool soft = false;
  PartPlacement clamped;
  dart::dynamics::SkeletonPtr skeleton;  // null for a clamped part
  double friction = 0;
  double radius_of_gyration = 0;  // m
  std::int32_t main_support = kNoSupport;
  std::vector<PairContact> contacts;
  StickState stick;

  dart::dynamics::BodyNode* body() const { return skeleton->getBodyNode(0); }
  const Eigen::Isometry3d& pose() const { return body()->getWorldTransform(); }
};

struct World::Engine {
  dart::simulation::WorldPtr world;
  std::shared_ptr<CappedCollisionDetector> detector;
  std::shared_ptr<ContactFilter> filter;
  dart::dynamics::SkeletonPtr arm, table, ground;
  std::size_t first_link = 0;         // body of the first link; 1 in an arm whose base an axis carries
  std::vector<Carrier> frames;        // of the tree
  std::size_t base_carrier = kWorld;  // frame of the tree that carries the base of the arm
  std::vector<std::pair<dart::dynamics::FreeJoint*, std::size_t>> prescribed;  // and the frames they follow
  std::unique_ptr<DynamicArm> dynamic_arm;                                     // null with kinematic drives
  std::vector<dart::dynamics::SkeletonPtr> belts;
  std::unique_ptr<Gripper> gripper;  // null in a cell without gripper
  std::vector<Part> parts;
  std::vector<Support> supports;
  std::vector<PointContact> point_contacts;  // of free parts in the last step
  FallbackCount solver_fallbacks = std::make_shared<std::int32_t>(0);
  bool stick = true;  // stick constraints are on

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
  dart::dynamics::BodyNode* link(std::size_t i) const { return arm->getBodyNode(first_link + i); }
  dart::dynamics::Joint* joint(std::size_t i) const { return link(i)->getParentJoint(); }

  /// Body and pose of a support; the environment for kNoSupport. The frame of a belt travels with its
  /// surface.
  dart::dynamics::BodyNode* body_of(std::int32_t support) const;
  Eigen::Isometry3d pose_of(std::int32_t support) const;
  /// Frame with which a part moves that rests on a support, directly or on other parts.
  std::size_t frame_of(std::int32_t support) const;

  /// The free part with this support number; null for other supports.
  Part* free_part(std::int32_t support);
  const Part* free_part(std::int32_t support) const;

  /// Force of a finger's pad on all parts in the last step (N): sum of normal forces, and total force vector.
  std::pair<double, Eigen::Vector3d> pad_force(std::size_t finger) const;

  /// Whether a support is a soft part.
  bool is_soft(std::int32_t support) const;

  /// Call before and after a step of the engine: reads the contacts, and applies the stick constraints.
  void begin_step();
  void end_step(double time_step);

  /// Throws std::invalid_argument where the states belong to other parts.
  void check(const std::vector<FreePartState>& states) const;

 private:
  void read_contacts();
  void add_contact(const PointContact& contact, const Eigen::Vector3d& normal);
  void split_forces(Part& part) const;
  bool moves_by_forces(const Support& support) const;
  bool can_touch(const Support& a, const Support& b) const;
  /// Number of a body in the chain of links from the base, from 0; fingers follow the last link.
  static int number_in_chain(const dart::dynamics::BodyNode* body);

  std::unordered_map<const dart::dynamics::ShapeFrame*, std::int32_t> support_of_shape_;
};

/// Records the poses of sticking parts relative to their supports. Call before a step of the engine.
void begin_stick_step(World::Engine& engine);

/// Projects sticking parts onto their stick constraints. Call after a step, when the contacts are read.
void apply_stick_constraints(World::Engine& engine, double time_step);

}  // namespace robotcell
