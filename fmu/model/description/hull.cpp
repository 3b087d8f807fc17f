#include "fmu/model/description/hull.h"

#include "fmu/model/description/json_reader.h"

namespace robotcell {

Hull parse_hull(const JsonReader& json) {
  json.expect_keys({"vertices", "faces"});
  Hull hull;
  hull.vertices = json.at("vertices").vertices();
  hull.faces = json.at("faces").faces(hull.vertices.size());
  if (hull.faces.size() < 4) json.at("faces").fail("at least 4 faces");
  return hull;
}

}  // namespace robotcell
