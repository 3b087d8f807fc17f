#include "fmu/fmi/model_description.h"

#include <charconv>
#include <locale>
#include <sstream>

#include "fmu/fmi/log.h"
#include "fmu/fmi/table_builder.h"

namespace robotcell::fmi {
namespace {

constexpr const char* kGenerationTool = "scancell " SCANCELL_VERSION;

std::string escaped(const std::string& text) {
  std::string xml;
  for (const char c : text) {
    switch (c) {
      case '&':
        xml += "&amp;";
        break;
      case '<':
        xml += "&lt;";
        break;
      case '>':
        xml += "&gt;";
        break;
      case '"':
        xml += "&quot;";
        break;
      default:
        xml += c;
    }
  }
  return xml;
}

/// Shortest text that reads back as the same number, in any locale.
std::string number(double value) {
  char buffer[32];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr};
}

const char* causality_name(Causality causality) {
  switch (causality) {
    case Causality::kIndependent:
      return "independent";
    case Causality::kParameter:
      return "parameter";
    case Causality::kInput:
      return "input";
    default:
      return "output";
  }
}

const char* variability_name(Variability variability) {
  switch (variability) {
    case Variability::kFixed:
      return "fixed";
    case Variability::kDiscrete:
      return "discrete";
    default:
      return "continuous";
  }
}

const char* type_name(Type type, int version) {
  switch (type) {
    case Type::kReal:
      return version == 2 ? "Real" : "Float64";
    case Type::kInteger:
      return version == 2 ? "Integer" : "Int32";
    case Type::kBoolean:
      return "Boolean";
    default:
      return "String";
  }
}

/// FMI 2 counts variables from 1 in its model structure, FMI 3 uses value references.
std::size_t structure_index(std::size_t reference, int version) {
  return version == 2 ? reference + 1 : reference;
}

std::string start_of(const Variable& variable) {
  switch (variable.type) {
    case Type::kReal:
      return number(member<double>(variable));
    case Type::kInteger:
      return std::to_string(member<std::int32_t>(variable));
    case Type::kBoolean:
      return member<bool>(variable) ? "true" : "false";
    default:
      return escaped(member<std::string>(variable));
  }
}

bool has_start(const Variable& variable) {
  return variable.causality == Causality::kParameter || variable.causality == Causality::kInput;
}

/// Attributes that the type carries: declared type, bounds, start (an FMI 3 string's start is an element).
/// The unit comes with the declared type; FMI 2 importers look for it at the variable as well, while strict
/// readers of FMI 3 stumble over it there.
std::string type_attributes(const Variable& variable, int version) {
  std::string text;
  const Unit& unit = variable.unit;
  if (*unit.quantity != '\0') text += std::string(" declaredType=\"") + unit.quantity + "\"";
  if (version == 2 && *unit.name != '\0') text += std::string(" unit=\"") + unit.name + "\"";
  if (version == 2 && *unit.display != '\0') text += std::string(" displayUnit=\"") + unit.display + "\"";
  if (variable.max > variable.min) {
    text += " min=\"" + std::to_string(variable.min) + "\" max=\"" + std::to_string(variable.max) + "\"";
  }
  if (has_start(variable) && (version == 2 || variable.type != Type::kString)) {
    text += " start=\"" + start_of(variable) + "\"";
  }
  return text;
}

std::string common_attributes(const Variable& variable, std::size_t reference) {
  std::string text = " name=\"" + escaped(variable.name) + "\" valueReference=\"" +
                     std::to_string(reference) + "\" causality=\"" + causality_name(variable.causality) +
                     "\" variability=\"" + variability_name(variable.variability) + "\"";
  if (variable.causality == Causality::kParameter) text += " initial=\"exact\"";
  if (variable.causality == Causality::kOutput) text += " initial=\"calculated\"";
  return text + " description=\"" + escaped(variable.description) + "\"";
}

void write_variables(std::ostream& xml, const VariableTable& table, int version, bool clock) {
  xml << "  <ModelVariables>\n";
  for (std::size_t i = 0; i < table.variables().size(); ++i) {
    const Variable& variable = table.variables()[i];
    const char* type = type_name(variable.type, version);
    const std::string attributes = type_attributes(variable, version);
    if (version == 2) {
      xml << "    <ScalarVariable" << common_attributes(variable, i) << "><" << type << attributes
          << "/></ScalarVariable>\n";
    } else if (variable.type == Type::kString && has_start(variable)) {
      xml << "    <" << type << common_attributes(variable, i) << "><Start value=\"" << start_of(variable)
          << "\"/></" << type << ">\n";
    } else {
      xml << "    <" << type << common_attributes(variable, i) << attributes << "/>\n";
    }
  }
  if (clock) {
    xml << "    <Clock name=\"trigger.clock\" valueReference=\"" << table.record_clock_reference()
        << "\" causality=\"output\" variability=\"discrete\" intervalVariability=\"triggered\" "
           "description=\"Ticks when the record of an exposure comes on display\"/>\n";
  }
  xml << "  </ModelVariables>\n";
}

/// One entry of the model structure. Outputs depend on no input at the same instant: what is commanded at a
/// communication point acts behind it.
void write_unknown(std::ostream& xml, const char* element, std::size_t reference,
                   const std::vector<std::uint32_t>& dependencies, int version) {
  xml << "<" << element << (version == 2 ? " index=\"" : " valueReference=\"")
      << structure_index(reference, version) << "\" dependencies=\"";
  for (std::size_t i = 0; i < dependencies.size(); ++i) {
    xml << (i > 0 ? " " : "") << structure_index(dependencies[i], version);
  }
  xml << "\"/>\n";
}

void write_structure(std::ostream& xml, const VariableTable& table, int version, bool clock) {
  xml << "  <ModelStructure>\n" << (version == 2 ? "    <Outputs>\n" : "");
  const char* indent = version == 2 ? "      " : "    ";
  for (std::size_t i = 0; i < table.variables().size(); ++i) {
    if (table.variables()[i].causality != Causality::kOutput) continue;
    xml << indent;
    write_unknown(xml, version == 2 ? "Unknown" : "Output", i, {}, version);
  }
  if (clock) {
    xml << indent;
    write_unknown(xml, "Output", table.record_clock_reference(), {}, version);
  }
  if (version == 2) xml << "    </Outputs>\n    <InitialUnknowns>\n";
  for (std::size_t i = 0; i < table.variables().size(); ++i) {
    if (table.variables()[i].causality != Causality::kOutput) continue;
    xml << indent;
    write_unknown(xml, version == 2 ? "Unknown" : "InitialUnknown", i,
                  table.variables()[i].initial_dependencies, version);
  }
  xml << (version == 2 ? "    </InitialUnknowns>\n" : "") << "  </ModelStructure>\n";
}

struct UnitDefinition {
  Unit unit;
  const char* base;            // exponents of SI base units
  const char* display_factor;  // of the display unit
};

constexpr const char* kDegrees = "57.29577951308232";
constexpr UnitDefinition kUnits[] = {
    {kSecond, "s=\"1\"", "1000"},
    {kMetre, "m=\"1\"", "1000"},
    {kRadian, "rad=\"1\"", kDegrees},
    {kMetrePerSecond, "m=\"1\" s=\"-1\"", "1000"},
    {kRadianPerSecond, "rad=\"1\" s=\"-1\"", kDegrees},
};

void write_units_and_types(std::ostream& xml, int version) {
  xml << "  <UnitDefinitions>\n";
  for (const auto& [unit, base, factor] : kUnits) {
    xml << "    <Unit name=\"" << unit.name << "\"><BaseUnit " << base << "/><DisplayUnit name=\""
        << unit.display << "\" factor=\"" << factor << "\"/></Unit>\n";
  }
  xml << "  </UnitDefinitions>\n  <TypeDefinitions>\n";
  for (const UnitDefinition& definition : kUnits) {
    const Unit& unit = definition.unit;
    const std::string name = std::string(" name=\"") + unit.quantity + "\"";
    const std::string attributes = std::string(" quantity=\"") + unit.quantity + "\" unit=\"" + unit.name +
                                   "\" displayUnit=\"" + unit.display + "\"/>";
    if (version == 2) {
      xml << "    <SimpleType" << name << "><Real" << attributes << "</SimpleType>\n";
    } else {
      xml << "    <Float64Type" << name << attributes << "\n";
    }
  }
  xml << "  </TypeDefinitions>\n";
}

void write_head(std::ostream& xml, const CellDescription& cell, const std::string& token,
                const DescriptionOptions& options) {
  const int version = options.version;
  const std::string needs = options.needs.empty() ? "" : " (needs " + options.needs + ")";
  xml << "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fmiModelDescription fmiVersion=\""
      << (version == 2 ? "2.0" : "3.0") << "\" modelName=\"RobotCell\" "
      << (version == 2 ? "guid" : "instantiationToken") << "=\"" << token
      << "\" description=\"Robot cell that scans a part with a laser profile sensor: "
      << escaped(cell.name + needs) << "\" version=\"" << SCANCELL_VERSION
      << "\" license=\"BSD-3-Clause\" generationTool=\"" << kGenerationTool
      << "\" variableNamingConvention=\"structured\">\n  <CoSimulation modelIdentifier=\"RobotCell\" "
         "canHandleVariableCommunicationStepSize=\"true\" ";
  if (version == 2) {
    xml << "canGetAndSetFMUstate=\"true\" canSerializeFMUstate=\"true\"/>\n";
  } else {
    xml << "canGetAndSetFMUState=\"true\" canSerializeFMUState=\"true\" hasEventMode=\"true\" "
           "mightReturnEarlyFromDoStep=\"true\" canReturnEarlyAfterIntermediateUpdate=\"true\" "
           "providesIntermediateUpdate=\"true\"/>\n";
  }
}

}  // namespace

std::string model_description(const CellDescription& cell, const DescriptionOptions& options) {
  const int version = options.version;
  const bool clock = options.clock && version == 3;
  std::ostringstream xml;
  xml.imbue(std::locale::classic());
  const CellLayout layout = layout_of(cell);
  Values values(layout);
  const VariableTable table(layout, values);
  write_head(xml, cell, table.token(), options);
  write_units_and_types(xml, version);
  xml << "  <LogCategories>\n";
  for (const auto& [name, description] : kLogCategories) {
    xml << "    <Category name=\"" << name << "\" description=\"" << description << "\"/>\n";
  }
  xml << "  </LogCategories>\n";
  xml << "  <DefaultExperiment startTime=\"0\" stopTime=\"10\" stepSize=\""
      << number(static_cast<double>(cell.controller_cycle_us) / 1e6) << "\"/>\n";
  write_variables(xml, table, version, clock);
  write_structure(xml, table, version, clock);
  xml << "</fmiModelDescription>\n";
  return xml.str();
}

}  // namespace robotcell::fmi
