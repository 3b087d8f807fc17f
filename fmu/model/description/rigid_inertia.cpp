#include "fmu/model/description/rigid_inertia.h"

#include <Eigen/Cholesky>

#include "fmu/model/description/json_reader.h"

namespace robotcell {

RigidInertia parse_inertia(const JsonReader& json) {
  json.expect_keys({"mass", "centre_of_mass", "inertia"});
  RigidInertia body;
  body.mass = json.at("mass").mass();
  body.centre_of_mass = json.at("centre_of_mass").coordinates();
  const auto rows = json.at("inertia").items(3);
  for (int i = 0; i < 3; ++i) body.inertia.row(i) = rows[static_cast<std::size_t>(i)].vector3();
  if (body.inertia.llt().info() != Eigen::Success) json.at("inertia").fail("a positive definite matrix");
  return body;
}

}  // namespace robotcell
