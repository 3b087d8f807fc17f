// Builder of the variable table, with groups of variables that occur several times.
#pragma once

#include <algorithm>
#include <array>
#include <string>
#include <utility>
#include <vector>

#include "fmu/fmi/variable_table.h"

namespace robotcell::fmi {

using Refs = std::vector<std::uint32_t>;

constexpr std::array<const char*, 3> kAxisNames{"x", "y", "z"};

/// "name[1]" for index 0.
std::string indexed(const std::string& name, std::size_t index_from_0);

/// Parameters on which the initial pose of a body depends.
struct PoseDependencies {
  Refs position, orientation;
  Refs velocity;  // empty without vibration, where everything starts from rest
};

struct BodiesDependencies {
  std::vector<PoseDependencies> axes, links;
  PoseDependencies sensor, table;
  std::vector<PoseDependencies> parts, fingers, further_sensors;
};

/// Parameters on which initial values depend.
struct Dependencies {
  Refs file, measured;
  Refs true_axes;  // with dynamic drives: gravity deflection depends on the geometry as built
  BodiesDependencies bodies;
};

class TableBuilder {
 public:
  explicit TableBuilder(const CellLayout& layout) : joints_(layout.joints.size()), axes_(layout.axes) {}

  std::size_t joints() const { return joints_; }
  /// Beside joints and table.
  const std::vector<AxisLayout>& axes() const { return axes_; }

  /// Appends a variable; `value` is its member of an instance's values.
  template <class T>
  std::uint32_t add(const std::string& name, Causality causality, Variability variability, Unit unit,
                    const std::string& description, T& value, Refs dependencies = {}) {
    std::sort(dependencies.begin(), dependencies.end());
    dependencies.erase(std::unique(dependencies.begin(), dependencies.end()), dependencies.end());
    table_.push_back({name,
                      TypeOf<T>::value,
                      causality,
                      variability,
                      unit,
                      description,
                      &value,
                      -kUnbounded,
                      kUnbounded,
                      dependencies,
                      nullptr,
                      false,
                      clocked_,
                      {}});
    return static_cast<std::uint32_t>(table_.size() - 1);
  }

  /// Sets the bounds of the number that was added last.
  void bound(double min, double max = kUnbounded);

  /// Makes the integer that was added last an enumeration, and appends its members to the text.
  void enumerate(const Enumeration& enumeration);

  /// Names a position and a velocity, in the text of the variable that was added last, where it names angles.
  void replace_angles();

  /// Marks the variable that was added last as an instant of simulation time.
  void mark_instant() { table_.back().instant = true; }

  /// Whether variables added from now on change only with the clock of the trigger records.
  void set_clocked(bool clocked) { clocked_ = clocked; }
  std::vector<Variable> clocked_variables() const;

  /// Makes the variable that was added last an array.
  void make_array(const std::vector<std::uint32_t>& dimensions) { table_.back().dimensions = dimensions; }

  /// Appends an array of values of a variable, of which `value` is the first.
  void add_array(Variable of, const std::string& name, void* value, std::uint32_t size);

  /// Adds a fixed parameter "as_built.<name>".
  std::uint32_t add_deviation(const std::string& name, Unit unit, const std::string& text, double& value);

  /// Adds poses and twists of all bodies, present or in a record.
  void add_bodies(const std::string& prefix, const std::string& suffix, Variability variability,
                  Bodies& value, const BodiesDependencies& dependencies);

  /// Adds the members that a structure declares. `prefix` precedes their names, and `device` is its name in
  /// texts.
  template <class Structure>
  void add_declared(const std::string& prefix, const std::string& device, Causality causality,
                    Structure& structure, const Dependencies& dependencies = {});

  /// The variables; their texts say which values are clamped.
  std::vector<Variable> take();

 private:
  void add_body(const std::string& prefix, const std::string& what, const std::string& suffix,
                Variability variability, BodyState& value, const PoseDependencies& dependencies);

  std::size_t joints_;
  std::vector<AxisLayout> axes_;
  bool clocked_ = false;
  std::vector<Variable> table_;
};

template <class T, class = void>
struct IsVariable : std::false_type {};
template <class T>
struct IsVariable<T, std::void_t<decltype(TypeOf<T>::value)>> : std::true_type {};

/// Of an element of an array, from 0. In an array of arrays: of the outer and of the inner one.
struct ElementIndex {
  std::size_t outer = 0, inner = 0;
  std::size_t inner_count = 0;
};

/// Visits the members that a structure declares (fields.h).
class FieldTable {
 public:
  FieldTable(TableBuilder& table, std::string prefix, std::string device, Causality causality,
             const Dependencies& dependencies)
      : table_(table),
        prefix_(std::move(prefix)),
        device_(std::move(device)),
        causality_(causality),
        dependencies_(dependencies) {}

  template <class Structure, class... T>
  void operator()(Structure& structure, const Declared<T>&... members) {
    require_members<sizeof...(T)>(structure);
    (add(members), ...);
  }

 private:
  template <class T>
  void add(const Declared<T>& member) {
    if constexpr (IsVariable<T>::value) {
      if (member.field.text != nullptr) add(member.field, member.value, {"", ""}, {});
    }
  }
  template <class T, std::size_t n>
  void add(const Declared<std::array<T, n>>& member) {
    if (member.field.text == nullptr) return;
    const Element* elements = member.field.elements;
    for (std::size_t i = 0; i < n; ++i) {
      if (elements == nullptr) {
        add(member.field, member.value[i], {"", ""}, {i, i, n});
      } else if (i < table_.joints() || i == kTableAxis) {
        const Element& element = elements[member.field.distinct_joints ? i : i / kTableAxis];
        add(member.field, member.value[i], element, {i, i, n});
      } else if (i >= kFirstFurtherAxis && i - kFirstFurtherAxis < table_.axes().size()) {
        const bool slides = table_.axes()[i - kFirstFurtherAxis].slides;
        const Element& element = elements[member.field.distinct_joints ? kFirstFurtherAxis : 2];
        add(slides ? sliding(member.field) : member.field, member.value[i], element, {i, i, n});
        if (slides) table_.replace_angles();
      }
    }
  }
  template <class T, std::size_t n, std::size_t m>
  void add(const Declared<std::array<std::array<T, m>, n>>& member) {
    for (std::size_t i = 0; i < n * m; ++i) {
      add(member.field, member.value[i / m][i % m], {"", ""}, {i / m, i % m, m});
    }
  }
  template <class T>
  void add(const Field& field, T& value, const Element& element, const ElementIndex& index) {
    table_.add(with_names(prefix_ + field.name + element.name, element, index), causality_,
               causality_ == Causality::kParameter ? Variability::kFixed : field.variability, field.unit,
               with_names(field.text, element, index), value, initial_of(field));
    const auto last = static_cast<double>(table_.joints() + 1 + table_.axes().size());
    table_.bound(field.min, field.axis_number ? last : field.max);
    if (field.instant) table_.mark_instant();
    if (field.enumeration != nullptr) table_.enumerate(*field.enumeration);
  }
  std::string with_names(std::string text, const Element& element, const ElementIndex& index) const;
  const Refs& initial_of(const Field& field) const;

  TableBuilder& table_;
  std::string prefix_, device_;
  Causality causality_;
  const Dependencies& dependencies_;
};

template <class Structure>
void TableBuilder::add_declared(const std::string& prefix, const std::string& device, Causality causality,
                                Structure& structure, const Dependencies& dependencies) {
  FieldTable visit(*this, prefix, device, causality, dependencies);
  Structure::declare(visit, structure);
}

}  // namespace robotcell::fmi
