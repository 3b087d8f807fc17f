// Entry points of FMI 3.0 for co-simulation.
#include <array>
#include <memory>

#include "fmu/fmi/fmi3_calls.h"
#include "fmu/fmi/variable_table.h"

namespace {

using namespace robotcell::fmi;

Log::Sink make_sink(fmi3LogMessageCallback callback, fmi3InstanceEnvironment environment) {
  if (callback == nullptr) return {};
  return [callback, environment](LogCategory category, const std::string& message) {
    constexpr std::array<fmi3Status, 3> kStatus{fmi3Error, fmi3Warning, fmi3OK};
    const auto index = static_cast<std::size_t>(category);
    callback(environment, kStatus[index], kLogCategories[index].name, message.c_str());
  };
}

/// Calls `use(reference, element, position)` for every scalar of the referenced variables, after checking
/// that `n_values` is their number. The elements of an array have its reference, or, where scalars were
/// merged, their own ones.
template <class Use>
void for_each_value(const Instance& instance, const fmi3ValueReference vr[], size_t n, size_t n_values,
                    const Use& use) {
  size_t count = 0;
  for (size_t i = 0; i < n; ++i) count += instance.size_of(vr[i]);
  require(count == n_values, "the number of values does not match the size of the variables");
  size_t at = 0;
  for (size_t i = 0; i < n; ++i) {
    const auto size = static_cast<std::uint32_t>(instance.size_of(vr[i]));
    const bool array = is_array(instance.table().at(vr[i]));
    for (std::uint32_t element = 0; element < size; ++element) {
      use(array ? vr[i] : vr[i] + element, array ? element : 0, at++);
    }
  }
}

template <class T, class Value>
fmi3Status get_values(fmi3Instance instance, const char* function, const fmi3ValueReference vr[], size_t n,
                      Value values[], size_t n_values, bool enumerations = false) {
  return status_of(instance, function, [&] {
    require(n == 0 || (vr != nullptr && values != nullptr), "an argument is a null pointer");
    Instance& own = *instance_of(instance);
    for_each_value(own, vr, n, n_values, [&](std::uint32_t reference, size_t element, size_t at) {
      const T& value =
          own.get<T>(reference, element, enumerations ? Type::kEnumeration : own.accessed_type<T>(reference));
      if constexpr (std::is_same_v<T, std::string>) {
        values[at] = value.c_str();
      } else {
        values[at] = value;
      }
    });
  });
}

template <class T, class Value>
fmi3Status set_values(fmi3Instance instance, const char* function, const fmi3ValueReference vr[], size_t n,
                      const Value values[], size_t n_values, bool enumerations = false) {
  bool unchanged = true;
  const fmi3Status status = status_of(instance, function, [&] {
    require(n == 0 || (vr != nullptr && values != nullptr), "an argument is a null pointer");
    Instance& own = *instance_of(instance);
    for_each_value(own, vr, n, n_values, [&](std::uint32_t reference, size_t, size_t at) {
      if constexpr (std::is_same_v<T, std::string>)
        require(values[at] != nullptr, "a string is a null pointer");
      if constexpr (std::is_same_v<Value, fmi3Int64>) {
        require(values[at] == static_cast<T>(values[at]), "a value is not a member of the enumeration");
      }
      unchanged = own.set<T>(reference, static_cast<T>(values[at]),
                             enumerations ? Type::kEnumeration : own.accessed_type<T>(reference)) &&
                  unchanged;
    });
  });
  return status == fmi3OK && !unchanged ? fmi3Warning : status;
}

std::function<std::optional<double>(double)> make_intermediate(fmi3IntermediateUpdateCallback callback,
                                                               fmi3InstanceEnvironment environment,
                                                               bool early_return) {
  if (callback == nullptr) return {};
  return [=](double time) -> std::optional<double> {
    fmi3Boolean requested = fmi3False;
    fmi3Float64 until = time;
    callback(environment, time, fmi3False, fmi3True, fmi3True, early_return, &requested, &until);
    return requested ? std::optional<double>(until) : std::nullopt;
  };
}

}  // namespace

extern "C" {

const char* fmi3GetVersion() { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean on, size_t n,
                               const fmi3String categories[]) {
  bool known = true;
  const fmi3Status status = status_of(instance, "fmi3SetDebugLogging", [&] {
    known = switch_logging(*instance_of(instance), "fmi3SetDebugLogging", &Log::switch_categories, on, n,
                           categories);
  });
  return known ? status : fmi3Warning;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean,
                                         fmi3Boolean logging, fmi3Boolean event_mode,
                                         fmi3Boolean early_return,
                                         const fmi3ValueReference intermediate_variables[], size_t n,
                                         fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log_message,
                                         fmi3IntermediateUpdateCallback intermediate) {
  try {
    const Log log(make_sink(log_message, environment), logging);
    const auto reject = [&log](const std::string& message) {
      log.write(LogCategory::kError, "fmi3InstantiateCoSimulation: " + message);
      return nullptr;
    };
    if (name == nullptr || *name == '\0') return reject("the instance name is empty");
    try {
      StepOptions options{
          event_mode, early_return, make_intermediate(intermediate, environment, early_return), {}};
      if (n > 0) {
        require(intermediate_variables != nullptr, "requiredIntermediateVariables is a null pointer");
        options.intermediate_variables.assign(intermediate_variables, intermediate_variables + n);
      }
      auto instance = make_instance(name, resources == nullptr ? "" : resources, log, options);
      if (token == nullptr || !instance->use_variant(token, 3)) {
        return reject("wrong instantiation token, expected " + instance->token());
      }
      instance->check_intermediate_variables();
      return instance.release();
    } catch (const std::exception& error) {
      return reject(error.what());
    }
  } catch (...) {
    return nullptr;
  }
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log_message) {
  if (log_message != nullptr) {
    log_message(environment, fmi3Error, "logStatusError",
                "fmi3InstantiateModelExchange: only co-simulation is supported");
  }
  return nullptr;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean,
                                               fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log_message, fmi3ClockUpdateCallback,
                                               fmi3LockPreemptionCallback, fmi3UnlockPreemptionCallback) {
  if (log_message != nullptr) {
    log_message(environment, fmi3Error, "logStatusError",
                "fmi3InstantiateScheduledExecution: only co-simulation is supported");
  }
  return nullptr;
}

void fmi3FreeInstance(fmi3Instance instance) { free_instance(instance_of(instance)); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean, fmi3Float64, fmi3Float64 start,
                                       fmi3Boolean stop_defined, fmi3Float64 stop) {
  return status_of(instance, "fmi3EnterInitializationMode", [&] {
    instance_of(instance)->setup(start, stop_defined ? std::optional<double>(stop) : std::nullopt);
    instance_of(instance)->enter_initialization();
  });
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
  return status_of(instance, "fmi3ExitInitializationMode",
                   [&] { instance_of(instance)->exit_initialization(); });
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
  return status_of(instance, "fmi3Terminate", [&] { instance_of(instance)->terminate(); });
}

fmi3Status fmi3Reset(fmi3Instance instance) {
  return status_of(instance, "fmi3Reset", [&] { instance_of(instance)->reset(); });
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          fmi3Float64 values[], size_t n_values) {
  return get_values<double>(instance, "fmi3GetFloat64", vr, n, values, n_values);
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Int32 values[],
                        size_t n_values) {
  return get_values<std::int32_t>(instance, "fmi3GetInt32", vr, n, values, n_values);
}

/// In FMI 3 enumerations have 64 bits.
fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Int64 values[],
                        size_t n_values) {
  return get_values<std::int32_t>(instance, "fmi3GetInt64", vr, n, values, n_values, true);
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          fmi3Boolean values[], size_t n_values) {
  return get_values<bool>(instance, "fmi3GetBoolean", vr, n, values, n_values);
}

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3String values[],
                         size_t n_values) {
  return get_values<std::string>(instance, "fmi3GetString", vr, n, values, n_values);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          const fmi3Float64 values[], size_t n_values) {
  return set_values<double>(instance, "fmi3SetFloat64", vr, n, values, n_values);
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                        const fmi3Int32 values[], size_t n_values) {
  return set_values<std::int32_t>(instance, "fmi3SetInt32", vr, n, values, n_values);
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                        const fmi3Int64 values[], size_t n_values) {
  return set_values<std::int32_t>(instance, "fmi3SetInt64", vr, n, values, n_values, true);
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                          const fmi3Boolean values[], size_t n_values) {
  return set_values<bool>(instance, "fmi3SetBoolean", vr, n, values, n_values);
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
                         const fmi3String values[], size_t n_values) {
  return set_values<std::string>(instance, "fmi3SetString", vr, n, values, n_values);
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState* state) {
  return status_of(instance, "fmi3GetFMUState", [&] { get_state(*instance_of(instance), state); });
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
  return status_of(instance, "fmi3SetFMUState", [&] { instance_of(instance)->restore(state_of(state)); });
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState* state) {
  return status_of(instance, "fmi3FreeFMUState", [&] { free_state(state); });
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t* size) {
  return status_of(instance, "fmi3SerializedFMUStateSize", [&] {
    require(size != nullptr, "an argument is a null pointer");
    *size = instance_of(instance)->serialize(state_of(state)).size();
  });
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  return status_of(instance, "fmi3SerializeFMUState",
                   [&] { write_state(*instance_of(instance), state, bytes, size); });
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte bytes[], size_t size,
                                   fmi3FMUState* state) {
  return status_of(instance, "fmi3DeserializeFMUState",
                   [&] { read_state(*instance_of(instance), bytes, size, state); });
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 current, fmi3Float64 step, fmi3Boolean,
                      fmi3Boolean* event_handling_needed, fmi3Boolean* terminate_simulation,
                      fmi3Boolean* early_return, fmi3Float64* last_successful_time) {
  StepResult result;
  const fmi3Status status =
      status_of(instance, "fmi3DoStep", [&] { result = instance_of(instance)->do_step(current, step); });
  if (event_handling_needed != nullptr) *event_handling_needed = result.event;
  if (terminate_simulation != nullptr) *terminate_simulation = fmi3False;
  if (early_return != nullptr) *early_return = result.early;
  if (instance != nullptr && last_successful_time != nullptr) {
    *last_successful_time = instance_of(instance)->last_successful_time();
  }
  return status;
}

}  // extern "C"
