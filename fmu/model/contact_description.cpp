#include "fmu/model/contact_description.h"

#include <algorithm>

#include "fmu/model/json_reader.h"

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

ContactDescription parse_contact(const JsonReader& json, const std::vector<std::string>& bodies) {
  json.expect_keys({"solver", "points", "stick", "pairs"});
  ContactDescription contact;
  const std::string solver = json.at("solver").text();
  if (solver != "dantzig" && solver != "pgs") json.at("solver").fail("\"dantzig\" or \"pgs\"");
  contact.gauss_seidel = solver == "pgs";
  contact.points = parse_points(json.at("points"));
  contact.stick = json.at("stick").boolean();
  for (const JsonReader& pair : json.at("pairs").items()) {
    pair.expect_keys({"bodies", "points"});
    const auto names = pair.at("bodies").items(2);
    contact.pairs.push_back(
        {{parse_body(names[0], bodies), parse_body(names[1], bodies)}, parse_points(pair.at("points"))});
  }
  return contact;
}

}  // namespace robotcell
