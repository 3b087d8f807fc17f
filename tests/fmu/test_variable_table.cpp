// The token identifies all that an importer reads from a model description, but texts.
#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

#include "fmu/control/robot_controller.h"
#include "fmu/fmi/variable_table.h"
#include "fmu/model/devices/trigger.h"

namespace robotcell::fmi {
namespace {

double real_value = 0;
std::int32_t integer_value = 0;

std::vector<Variable> two_variables() {
  Variable length{"length", Type::kReal, Causality::kInput, Variability::kDiscrete,
                  kMetre,   "A length",  &real_value,       -1,
                  1,        {},          nullptr,           false,
                  false,    {}};
  Variable mode{"mode",
                Type::kEnumeration,
                Causality::kOutput,
                Variability::kDiscrete,
                kNone,
                "A mode",
                &integer_value,
                0,
                5,
                {},
                &enumeration_of<TriggerMode>,
                false,
                false,
                {}};
  return {length, mode};
}

TEST(VariableTable, TokenDependsOnAllThatImportersRead) {
  static const EnumerationItem kOther[] = {{"off", "no exposures"}, {"on", "exposures"}};
  static const Enumeration kOtherMode = make_enumeration("TriggerMode", kOther);
  const std::vector<std::function<void(std::vector<Variable>&)>> changes{
      [](auto& v) { v[0].name = "width"; },
      [](auto& v) { v[0].type = Type::kInteger; },
      [](auto& v) { v[0].causality = Causality::kOutput; },
      [](auto& v) { v[0].variability = Variability::kContinuous; },
      [](auto& v) { v[0].unit = kRadian; },
      [](auto& v) { v[0].unit.display = "cm"; },
      [](auto& v) { v[0].unit.display_factor = "100"; },
      [](auto& v) { v[0].min = -2; },
      [](auto& v) { v[0].max = kUnbounded; },
      [](auto& v) { v[0].clocked = true; },
      [](auto& v) { v[0].dimensions = {3}; },
      [](auto& v) { v[1].enumeration = &kOtherMode; },
      [](auto& v) { std::swap(v[0], v[1]); },
      [](auto& v) { v.pop_back(); },
  };
  const std::string token = VariableTable(two_variables()).token(false);
  EXPECT_EQ(VariableTable(two_variables()).token(false), token);
  EXPECT_NE(VariableTable(two_variables()).token(true), token);
  for (std::size_t i = 0; i < changes.size(); ++i) {
    std::vector<Variable> changed = two_variables();
    changes[i](changed);
    EXPECT_NE(VariableTable(changed).token(false), token) << i;
  }
}

}  // namespace
}  // namespace robotcell::fmi
