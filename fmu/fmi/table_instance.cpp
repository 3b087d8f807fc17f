#include "fmu/fmi/table_instance.h"

#include "fmu/fmi/sealed_state.h"

namespace robotcell::fmi {

/// Values of all variables, as bytes.
struct TableInstance::State : SavedState {
  SavedPhase saved;
  double memory = 0;
  std::vector<std::uint8_t> values;

  void assign(const SavedState& other) override { *this = dynamic_cast<const State&>(other); }
};

namespace {

template <class T, class Archive>
void exchange_elements(Archive& archive, const Variable& variable) {
  T* first = &member<T>(variable);
  for (std::size_t i = 0; i < scalars_of(variable); ++i) exchange(archive, first[i]);
}

/// Exchanges the values of all variables with bytes.
template <class Archive>
void exchange_values(Archive& archive, const VariableTable& table) {
  for (const Variable& variable : table.variables()) {
    switch (variable.type) {
      case Type::kReal:
        exchange_elements<double>(archive, variable);
        break;
      case Type::kInteger:
      case Type::kEnumeration:
        exchange_elements<std::int32_t>(archive, variable);
        break;
      case Type::kBoolean:
        exchange_elements<bool>(archive, variable);
        break;
      default:
        exchange_elements<std::string>(archive, variable);
    }
  }
}

template <class Archive>
void exchange_head(Archive& archive, SavedPhase& saved, double& memory) {
  auto phase = static_cast<std::int32_t>(saved.phase);
  exchange_up_to(archive, phase, static_cast<std::int32_t>(Phase::kFailed));
  saved.phase = static_cast<Phase>(phase);
  exchange(archive, saved.start_time);
  exchange_unless_infinite(archive, saved.stop_time);
  exchange(archive, saved.communication_time);
  exchange(archive, memory);
}

constexpr std::uint64_t kStateLayout = 1;  // the token stands for the variables

std::vector<std::uint8_t> bytes_of(const VariableTable& table) {
  Writer writer;
  exchange_values(writer, table);
  return writer.take();
}

void read_values(const std::vector<std::uint8_t>& bytes, const VariableTable& table) {
  Reader reader(bytes.data(), bytes.size());
  exchange_values(reader, table);
  check_end(reader);
}

}  // namespace

std::unique_ptr<SavedState> TableInstance::snapshot() const {
  auto state = std::make_unique<State>();
  state->saved = saved_phase();
  state->memory = memory_;
  state->values = bytes_of(table());
  return state;
}

void TableInstance::restore(const SavedState& saved) {
  const auto& state = dynamic_cast<const State&>(saved);
  check_restorable(state.saved.phase);
  const std::vector<std::uint8_t> before = bytes_of(table());
  try {
    read_values(state.values, table());
    check_bounds();
    check_restored();
  } catch (...) {
    read_values(before, table());
    throw;
  }
  memory_ = state.memory;
  restore_phase(state.saved);
}

std::vector<std::uint8_t> TableInstance::serialize(const SavedState& saved) const {
  State state = dynamic_cast<const State&>(saved);
  Writer writer = sealed_writer(token(), kStateLayout);
  exchange_head(writer, state.saved, state.memory);
  exchange(writer, state.values);
  return sealed(writer);
}

std::unique_ptr<SavedState> TableInstance::deserialize(const std::uint8_t* bytes, std::size_t size) const {
  Reader reader = unsealed(bytes, size, token(), kStateLayout);
  auto state = std::make_unique<State>();
  exchange_head(reader, state->saved, state->memory);
  exchange(reader, state->values);
  check_end(reader);
  return state;
}

}  // namespace robotcell::fmi
