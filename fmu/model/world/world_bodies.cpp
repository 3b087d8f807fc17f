#include "fmu/model/world/world_bodies.h"

#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/BoxShape.hpp>
#include <dart/dynamics/CylinderShape.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/PrismaticJoint.hpp>
#include <dart/dynamics/RevoluteJoint.hpp>
#include <dart/dynamics/WeldJoint.hpp>

#include "fmu/model/world/hull_shape.h"
#include "fmu/model/world/soft_body.h"

namespace robotcell {
namespace {

using namespace dart::dynamics;
using Eigen::Vector3d;

constexpr std::size_t kMaxFaces = 60;

/// The hull, or a reduced one where it has too many faces for the collision detector.
Hull contact_hull(const Hull& hull, const Vector3d& up) {
  return hull.faces.size() <= kMaxFaces ? hull : support_hull(hull.vertices, up);
}

Hull contact_hull(const PartDescription& part) {
  return contact_hull(part.hull, part.support_from_part.linear().row(2).transpose());
}

ShapeNode* add_shape(BodyNode* body, const ShapePtr& shape, double friction) {
  ShapeNode* node = body->createShapeNodeWith<CollisionAspect, DynamicsAspect>(shape);
  node->getDynamicsAspect()->setFrictionCoeff(friction);
  return node;
}

/// The hull as a shape of a body that moves by forces, or is prescribed.
ShapeNode* add_shape(BodyNode* body, const Eigen::Isometry3d& body_from_hull, const Hull& hull,
                     double friction, bool prescribed) {
  const PlacedShape placed = prescribed ? make_obstacle_shape(hull) : make_mesh_shape(hull);
  ShapeNode* node = add_shape(body, placed.shape, friction);
  node->setRelativeTransform(body_from_hull * placed.hull_from_shape);
  return node;
}

BodyNode::Properties named(const std::string& name) {
  return BodyNode::Properties(BodyNode::AspectProperties(name));
}

}  // namespace

SkeletonPtr make_arm(const Kinematics& kinematics, bool mobile) {
  SkeletonPtr arm = Skeleton::create("arm");
  BodyNode* parent = nullptr;
  const Tree& tree = kinematics.tree();
  const std::size_t base = kinematics.numbers().base();
  const bool carried = !tree.path(base).empty();
  if (carried) {
    FreeJoint::Properties joint;
    joint.mActuatorType = dart::dynamics::Joint::VELOCITY;
    parent = arm->createJointAndBodyNodePair<FreeJoint>(nullptr, joint, named("base")).second;
  }
  for (std::size_t i = 0; i < kinematics.joints(); ++i) {
    RevoluteJoint::Properties joint;
    joint.mName = "joint" + std::to_string(i + 1);
    joint.mAxis = Vector3d::UnitZ();
    joint.mActuatorType = dart::dynamics::Joint::VELOCITY;
    if (i == 0 && !carried) joint.mT_ParentBodyToJoint = tree[base].parent_from_joint;
    joint.mT_ChildBodyToJoint = tree[kinematics.numbers().joint(i)].joint_from_frame.inverse();
    const auto body = named("link" + std::to_string(i + 1));
    parent = arm->createJointAndBodyNodePair<RevoluteJoint>(parent, joint, body).second;
  }
  arm->setMobile(mobile);
  return arm;
}

SkeletonPtr make_table(const TableDescription& table, bool collides) {
  SkeletonPtr skeleton = Skeleton::create("table");
  BodyNode* platter =
      skeleton->createJointAndBodyNodePair<FreeJoint>(nullptr, FreeJoint::Properties(), named("platter"))
          .second;
  if (collides) {
    const auto shape = std::make_shared<CylinderShape>(table.radius, table.thickness);
    add_shape(platter, shape, table.friction)->setRelativeTranslation({0, 0, -table.thickness / 2});
  }
  skeleton->setMobile(false);
  return skeleton;
}

SkeletonPtr make_belt(const std::string& name, const ConveyorDescription& conveyor) {
  SkeletonPtr skeleton = Skeleton::create(name);
  PrismaticJoint::Properties joint;
  joint.mAxis = Vector3d::UnitX();
  joint.mT_ParentBodyToJoint = conveyor.world_from_belt;
  BodyNode* belt = skeleton->createJointAndBodyNodePair<PrismaticJoint>(nullptr, joint, named("belt")).second;
  const auto shape =
      std::make_shared<BoxShape>(Vector3d(conveyor.length, conveyor.width, conveyor.thickness));
  add_shape(belt, shape, conveyor.friction)->setRelativeTranslation({0, 0, -conveyor.thickness / 2});
  skeleton->setMobile(false);
  return skeleton;
}

SkeletonPtr make_carriage(const std::string& name) {
  SkeletonPtr skeleton = Skeleton::create(name);
  skeleton->createJointAndBodyNodePair<FreeJoint>(nullptr, FreeJoint::Properties(), named("carriage"));
  skeleton->setMobile(false);
  return skeleton;
}

SkeletonPtr make_ground() {
  SkeletonPtr skeleton = Skeleton::create("ground");
  skeleton->createJointAndBodyNodePair<WeldJoint>(nullptr, WeldJoint::Properties(), named("ground"));
  skeleton->setMobile(false);
  return skeleton;
}

SkeletonPtr make_free_part(const std::string& name, const PartDescription& part, double time_step) {
  if (part.soft) return make_soft_part(name, part, contact_hull(part), time_step);
  SkeletonPtr skeleton = Skeleton::create(name);
  BodyNode* body = skeleton->createJointAndBodyNodePair<FreeJoint>().second;
  body->setInertia(Inertia(part.inertial.mass, part.inertial.centre_of_mass, part.inertial.inertia));
  add_hull(body, Eigen::Isometry3d::Identity(), part);
  return skeleton;
}

ShapeNode* add_hull(BodyNode* body, const Eigen::Isometry3d& body_from_part, const PartDescription& part) {
  return add_shape(body, body_from_part, contact_hull(part), part.friction, !part.free);
}

ShapeNode* add_contact_shape(BodyNode* body, const Eigen::Isometry3d& body_from_frame, const Hull& hull,
                             double friction, bool prescribed) {
  return add_shape(body, body_from_frame, contact_hull(hull, Vector3d::UnitZ()), friction, prescribed);
}

}  // namespace robotcell
