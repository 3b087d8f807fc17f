#include "fmu/model/description/contact_description.h"

#include <algorithm>
#include <utility>

#include "fmu/model/description/json_reader.h"
#include "fmu/model/description/value_limits.h"

namespace robotcell {
namespace {

std::size_t parse_points(const JsonReader& json) { return static_cast<std::size_t>(json.integer(1, 100)); }

std::string parse_body(const JsonReader& json, const std::vector<std::string>& bodies) {
  const std::string name = json.text();
  if (std::find(bodies.begin(), bodies.end(), name) != bodies.end()) return name;
  std::string known;
  for (const std::string& body : bodies) known += (known.empty() ? "" : ", ") + body;
  json.fail("the name of a body: " + known);
}

}  // namespace

ContactDescription parse_contact(const JsonReader& json, const FrameNumbers& frames,
                                 std::vector<std::string> others) {
  json.expect_keys({"solver", "points", "stick", "friction", "bodies", "pairs"});
  ContactDescription contact;
  const std::string solver = json.at("solver").text();
  if (solver != "dantzig" && solver != "pgs") json.at("solver").fail("\"dantzig\" or \"pgs\"");
  contact.gauss_seidel = solver == "pgs";
  contact.points = parse_points(json.at("points"));
  contact.stick = json.at("stick").boolean();
  contact.friction = json.at("friction").number(0, kMaxFriction);
  std::vector<std::string> names = std::move(others);
  for (const JsonReader& body : json.at("bodies").items()) {
    body.expect_keys({"name", "frame", "hull"});
    const std::size_t frame = frames.parse(body.at("frame"));
    contact.bodies.push_back({body.at("name").text(), frame, parse_hull(body.at("hull"))});
    names.push_back(contact.bodies.back().name);
  }
  for (const JsonReader& pair : json.at("pairs").items()) {
    pair.expect_keys({"bodies", "points", "response"});
    const auto bodies = pair.at("bodies").items(2);
    contact.pairs.push_back({{parse_body(bodies[0], names), parse_body(bodies[1], names)},
                             parse_points(pair.at("points")),
                             pair.at("response").boolean()});
  }
  return contact;
}

}  // namespace robotcell
