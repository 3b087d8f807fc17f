#include "fmu/fmi/model_description.h"

#include <algorithm>
#include <cmath>
#include <locale>
#include <sstream>

#include "fmu/control/time_units.h"
#include "fmu/fmi/entries.h"
#include "fmu/fmi/log.h"
#include "fmu/fmi/number_text.h"
#include "fmu/fmi/table_builder.h"
#include "fmu/model/start_inputs.h"

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
    case Type::kEnumeration:
      return "Enumeration";
    default:
      return "String";
  }
}

/// FMI 2 uses one-based indices in the model structure, FMI 3 value references.
std::size_t structure_index(std::size_t reference, int version) {
  return version == 2 ? reference + 1 : reference;
}

std::string start_of(const Variable& variable) {
  switch (variable.type) {
    case Type::kReal:
      return number_text(member<double>(variable));
    case Type::kInteger:
    case Type::kEnumeration:
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

/// Attributes of the type: declared type, unit, bounds. FMI 2 importers read the unit from the variable;
/// strict FMI 3 parsers reject it there, so it is in the declared type only.
std::string type_attributes(const Variable& variable, int version) {
  if (variable.type == Type::kEnumeration) {
    return std::string(" declaredType=\"") + variable.enumeration->name + "\"";
  }
  std::string text;
  const Unit& unit = variable.unit;
  if (*unit.quantity != '\0') text += std::string(" declaredType=\"") + unit.quantity + "\"";
  if (version == 2 && *unit.name != '\0') text += std::string(" unit=\"") + unit.name + "\"";
  if (version == 2 && *unit.display != '\0') text += std::string(" displayUnit=\"") + unit.display + "\"";
  if (std::isfinite(variable.min)) text += " min=\"" + number_text(variable.min) + "\"";
  if (std::isfinite(variable.max)) text += " max=\"" + number_text(variable.max) + "\"";
  return text;
}

std::string common_attributes(const Variable& variable, const Entry& entry, int version) {
  std::string text = " name=\"" + escaped(entry.name) + "\" valueReference=\"" +
                     std::to_string(entry.reference) + "\" causality=\"" +
                     causality_name(variable.causality) + "\" variability=\"" +
                     variability_name(variable.variability) + "\"";
  if (variable.causality == Causality::kParameter) text += " initial=\"exact\"";
  if (variable.causality == Causality::kOutput) text += " initial=\"calculated\"";
  if (version == 3 && changes_in_steps(variable)) text += " intermediateUpdate=\"true\"";
  return text + " description=\"" + escaped(entry.description) + "\"";
}

/// The attribute `start` with a value for each element; empty where the standard does not allow it.
std::string start_attribute(const std::vector<Variable>& variables, const Entry& entry) {
  if (!has_start(variables[entry.reference])) return "";
  std::string text = " start=\"";
  for (std::uint32_t i = 0; i < entry.size; ++i) {
    text += (i > 0 ? " " : "") + start_of(variables[entry.reference + i]);
  }
  return text + "\"";
}

/// Sizes of an array; empty for a scalar.
std::string dimension_elements(const Variable& variable, const Entry& entry) {
  std::string text;
  std::vector<std::uint32_t> sizes = variable.dimensions;
  if (entry.size > 1) sizes = {entry.size};
  for (const std::uint32_t size : sizes) text += "<Dimension start=\"" + std::to_string(size) + "\"/>";
  return text;
}

/// `clock` is the attribute of clocked variables.
std::string variable_element(const std::vector<Variable>& variables, const Entry& entry, int version,
                             const std::string& clock) {
  const Variable& variable = variables[entry.reference];
  const std::string type = type_name(variable.type, version);
  const std::string common =
      common_attributes(variable, entry, version) + (variable.clocked ? clock : std::string());
  const std::string start = start_attribute(variables, entry);
  const std::string attributes = type_attributes(variable, version);
  if (version == 2) {
    return "<ScalarVariable" + common + "><" + type + attributes + start + "/></ScalarVariable>";
  }
  if (variable.type == Type::kString) {  // in FMI 3 the start of a string is an element
    const std::string value = has_start(variable) ? "<Start value=\"" + start_of(variable) + "\"/>" : "";
    return "<" + type + common + ">" + value + "</" + type + ">";
  }
  const std::string dimensions = dimension_elements(variable, entry);
  if (dimensions.empty()) return "<" + type + common + attributes + start + "/>";
  return "<" + type + common + attributes + start + ">" + dimensions + "</" + type + ">";
}

/// One entry of the model structure. Outputs have no direct feedthrough: inputs act after the communication
/// point.
void write_unknown(std::ostream& xml, const char* element, std::size_t reference,
                   const std::vector<std::uint32_t>& dependencies, int version) {
  xml << (version == 2 ? "      <" : "    <") << element
      << (version == 2 ? " index=\"" : " valueReference=\"") << structure_index(reference, version)
      << "\" dependencies=\"";
  for (std::size_t i = 0; i < dependencies.size(); ++i) {
    xml << (i > 0 ? " " : "") << structure_index(dependencies[i], version);
  }
  xml << "\"/>\n";
}

/// Lists of variables and of the model structure.
class Listing {
 public:
  Listing(const VariableTable& table, const DescriptionOptions& options)
      : table_(table),
        entries_(list_entries(table.variables(), options.arrays && options.version == 3)),
        version_(options.version),
        clock_(options.clock && options.version == 3) {}

  void write_variables(std::ostream& xml) const {
    xml << "  <ModelVariables>\n";
    const std::string clock = " clocks=\"" + std::to_string(table_.record_clock_reference()) + "\"";
    for (const Entry& entry : entries_) {
      xml << "    " << variable_element(table_.variables(), entry, version_, clock_ ? clock : "") << "\n";
    }
    if (clock_) {
      xml << "    <Clock name=\"trigger.clock\" valueReference=\"" << table_.record_clock_reference()
          << "\" causality=\"output\" variability=\"discrete\" intervalVariability=\"triggered\" "
             "description=\"Ticks when a new trigger record becomes the current one\"/>\n";
    }
    xml << "  </ModelVariables>\n";
  }

  void write_structure(std::ostream& xml) const {
    xml << "  <ModelStructure>\n" << (version_ == 2 ? "    <Outputs>\n" : "");
    write_outputs(xml, version_ == 2 ? "Unknown" : "Output", false);
    if (version_ == 2) xml << "    </Outputs>\n    <InitialUnknowns>\n";
    write_outputs(xml, version_ == 2 ? "Unknown" : "InitialUnknown", true);
    xml << (version_ == 2 ? "    </InitialUnknowns>\n" : "") << "  </ModelStructure>\n";
  }

 private:
  void write_outputs(std::ostream& xml, const char* element, bool initial) const {
    for (const Entry& entry : entries_) {
      const Variable& variable = table_.variables()[entry.reference];
      if (variable.causality != Causality::kOutput || (initial && clock_ && variable.clocked)) continue;
      const auto dependencies = initial ? entry.initial_dependencies : std::vector<std::uint32_t>();
      write_unknown(xml, element, entry.reference, dependencies, version_);
    }
    if (clock_ && !initial) write_unknown(xml, element, table_.record_clock_reference(), {}, version_);
  }

  const VariableTable& table_;
  std::vector<Entry> entries_;
  int version_;
  bool clock_;
};

/// Enumerations of a table, each once.
std::vector<const Enumeration*> enumerations_of(const VariableTable& table) {
  std::vector<const Enumeration*> found;
  for (const Variable& variable : table.variables()) {
    const auto same = [&variable](const Enumeration* known) { return known == variable.enumeration; };
    if (variable.type == Type::kEnumeration && std::none_of(found.begin(), found.end(), same)) {
      found.push_back(variable.enumeration);
    }
  }
  return found;
}

void write_enumeration(std::ostream& xml, const Enumeration& enumeration, int version) {
  const std::string name = std::string(" name=\"") + enumeration.name + "\"";
  xml << (version == 2 ? "    <SimpleType" + name + "><Enumeration>\n"
                       : "    <EnumerationType" + name + ">\n");
  for (std::int32_t i = 0; i < enumeration.count; ++i) {
    const EnumerationItem& item = enumeration.items[i];
    xml << "      <Item name=\"" << item.name << "\" value=\"" << i << "\" description=\""
        << escaped(item.text) << "\"/>\n";
  }
  xml << (version == 2 ? "    </Enumeration></SimpleType>\n" : "    </EnumerationType>\n");
}

void write_units_and_types(std::ostream& xml, const VariableTable& table, int version) {
  xml << "  <UnitDefinitions>\n";
  for (const Unit& unit : kUnits) {
    xml << "    <Unit name=\"" << unit.name << "\"><BaseUnit " << unit.base << "/><DisplayUnit name=\""
        << unit.display << "\" factor=\"" << unit.display_factor << "\"/></Unit>\n";
  }
  xml << "  </UnitDefinitions>\n  <TypeDefinitions>\n";
  for (const Unit& unit : kUnits) {
    const std::string name = std::string(" name=\"") + unit.quantity + "\"";
    const std::string attributes = std::string(" quantity=\"") + unit.quantity + "\" unit=\"" + unit.name +
                                   "\" displayUnit=\"" + unit.display + "\"/>";
    if (version == 2) {
      xml << "    <SimpleType" << name << "><Real" << attributes << "</SimpleType>\n";
    } else {
      xml << "    <Float64Type" << name << attributes << "\n";
    }
  }
  for (const Enumeration* enumeration : enumerations_of(table)) write_enumeration(xml, *enumeration, version);
  xml << "  </TypeDefinitions>\n";
}

void write_head(std::ostream& xml, const ModelHead& model, const std::string& token,
                const DescriptionOptions& options) {
  const int version = options.version;
  const std::string needs = options.needs.empty() ? "" : " (needs " + options.needs + ")";
  xml << "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<fmiModelDescription fmiVersion=\""
      << (version == 2 ? "2.0" : "3.0") << "\" modelName=\"" << model.name << "\" "
      << (version == 2 ? "guid" : "instantiationToken") << "=\"" << token << "\" description=\""
      << escaped(model.description + needs) << "\" version=\"" << SCANCELL_VERSION
      << "\" license=\"BSD-3-Clause\" generationTool=\"" << kGenerationTool
      << "\" variableNamingConvention=\"structured\">\n  <CoSimulation modelIdentifier=\"" << model.name
      << "\" canHandleVariableCommunicationStepSize=\"true\" ";
  if (version == 2) {
    xml << "canNotUseMemoryManagementFunctions=\"true\" canGetAndSetFMUstate=\"true\" "
           "canSerializeFMUstate=\"true\"/>\n";
    return;
  }
  xml << "canGetAndSetFMUState=\"true\" canSerializeFMUState=\"true\"";
  if (model.internal_step > 0) xml << " fixedInternalStepSize=\"" << number_text(model.internal_step) << "\"";
  if (model.has_events) {
    xml << " hasEventMode=\"true\" mightReturnEarlyFromDoStep=\"true\" "
           "canReturnEarlyAfterIntermediateUpdate=\"true\" providesIntermediateUpdate=\"true\"";
  }
  xml << "/>\n";
}

}  // namespace

std::string model_description(const CellDescription& cell, const DescriptionOptions& options) {
  const CellLayout layout = layout_of(cell);
  Values values(layout);
  values.inputs = start_inputs(cell);
  TableOptions groups;
  if (options.ahead) {
    groups.path_ahead = options.version == 2 ? PathAheadVariables::kScalars : PathAheadVariables::kArray;
  }
  groups.records = options.records && options.version == 3;
  return model_description(
      {"RobotCell", "Robot cell that scans a part with a laser profile sensor: " + cell.name,
       static_cast<double>(cell.controller_cycle_us) / kMicrosecondsPerSecond,
       static_cast<double>(cell.time_step_us) / kMicrosecondsPerSecond},
      VariableTable(layout, values, groups), options);
}

std::string model_description(const ModelHead& model, VariableTable table,
                              const DescriptionOptions& options) {
  const int version = options.version;
  std::ostringstream xml;
  xml.imbue(std::locale::classic());
  const std::string token = table.token(options.arrays && version == 3);
  if (options.integers) table.use_integers();
  write_head(xml, model, token, options);
  write_units_and_types(xml, table, version);
  xml << "  <LogCategories>\n";
  for (const auto& [name, description] : kLogCategories) {
    xml << "    <Category name=\"" << name << "\" description=\"" << description << "\"/>\n";
  }
  xml << "  </LogCategories>\n";
  xml << "  <DefaultExperiment startTime=\"0\" stopTime=\"10\" stepSize=\"" << number_text(model.step)
      << "\"/>\n";
  const Listing listing(table, options);
  listing.write_variables(xml);
  listing.write_structure(xml);
  xml << "</fmiModelDescription>\n";
  return xml.str();
}

}  // namespace robotcell::fmi
