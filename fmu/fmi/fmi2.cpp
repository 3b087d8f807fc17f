// Entry points of FMI 2.0 for co-simulation.
#include <array>
#include <memory>

#include "fmu/fmi/guard.h"
#include "fmu/fmi/variable_table.h"

extern "C" {
#include "fmu/third_party/fmi/fmi2Functions.h"
}

namespace {

using namespace robotcell::fmi;

Instance* instance_of(fmi2Component c) { return static_cast<Instance*>(c); }

template <class Call>
fmi2Status status_of(fmi2Component c, const char* function, const Call& call) {
  return guarded(instance_of(c), function, call) ? fmi2OK : fmi2Error;
}

/// Escapes a message that the importer passes through printf.
std::string printf_safe(const std::string& message) {
  std::string safe;
  for (const char c : message) safe += c == '%' ? std::string("%%") : std::string(1, c);
  return safe;
}

Log::Sink make_sink(const fmi2CallbackFunctions* functions, const std::string& name) {
  if (functions == nullptr || functions->logger == nullptr) return {};
  return [logger = functions->logger, environment = functions->componentEnvironment, name](
             LogCategory category, const std::string& message) {
    constexpr std::array<fmi2Status, 3> kStatus{fmi2Error, fmi2Warning, fmi2OK};
    const auto index = static_cast<std::size_t>(category);
    logger(environment, name.c_str(), kStatus[index], kLogCategories[index].name,
           printf_safe(message).c_str());
  };
}

template <class T, class Value>
fmi2Status get_values(fmi2Component c, const char* function, const fmi2ValueReference vr[], size_t n,
                      Value values[]) {
  return status_of(c, function, [&] {
    require(n == 0 || (vr != nullptr && values != nullptr), "an argument is a null pointer");
    for (size_t i = 0; i < n; ++i) {
      const T& value = instance_of(c)->get<T>(vr[i]);
      if constexpr (std::is_same_v<T, std::string>) {
        values[i] = value.c_str();
      } else {
        values[i] = value;
      }
    }
  });
}

template <class T, class Value>
fmi2Status set_values(fmi2Component c, const char* function, const fmi2ValueReference vr[], size_t n,
                      const Value values[]) {
  bool unchanged = true;
  const fmi2Status status = status_of(c, function, [&] {
    require(n == 0 || (vr != nullptr && values != nullptr), "an argument is a null pointer");
    for (size_t i = 0; i < n; ++i) {
      if constexpr (std::is_same_v<T, std::string>)
        require(values[i] != nullptr, "a string is a null pointer");
      unchanged = instance_of(c)->set<T>(vr[i], static_cast<T>(values[i])) && unchanged;
    }
  });
  return status == fmi2OK && !unchanged ? fmi2Warning : status;
}

fmi2Status unsupported(fmi2Component c, const char* function) {
  return status_of(c, function, [] { throw std::logic_error("this function is not supported"); });
}

}  // namespace

extern "C" {

const char* fmi2GetTypesPlatform() { return fmi2TypesPlatform; }

const char* fmi2GetVersion() { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  bool known = true;
  const fmi2Status status = status_of(c, "fmi2SetDebugLogging", [&] {
    known = switch_logging(*instance_of(c), "fmi2SetDebugLogging", &Log::select_only, on != fmi2False, n,
                           categories);
  });
  return known ? status : fmi2Warning;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions* functions, fmi2Boolean, fmi2Boolean logging) {
  try {
    const std::string instance_name = name == nullptr ? "" : name;
    const Log log(make_sink(functions, instance_name), logging != fmi2False);
    const auto reject = [&log](const std::string& message) {
      log.write(LogCategory::kError, "fmi2Instantiate: " + message);
      return nullptr;
    };
    if (instance_name.empty()) return reject("the instance name is empty");
    if (type != fmi2CoSimulation) return reject("only co-simulation is supported");
    try {
      auto instance = make_instance(instance_name, resources == nullptr ? "" : resources, log, {});
      if (guid == nullptr || !instance->use_variant(guid, 2)) {
        return reject("wrong GUID, expected " + instance->token());
      }
      return instance.release();
    } catch (const std::exception& error) {
      return reject(error.what());
    }
  } catch (...) {
    return nullptr;
  }
}

void fmi2FreeInstance(fmi2Component c) { free_instance(instance_of(c)); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean, fmi2Real, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
  return status_of(c, "fmi2SetupExperiment", [&] {
    instance_of(c)->setup(start, stop_defined != fmi2False ? std::optional<double>(stop) : std::nullopt);
  });
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  return status_of(c, "fmi2EnterInitializationMode", [&] { instance_of(c)->enter_initialization(); });
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  return status_of(c, "fmi2ExitInitializationMode", [&] { instance_of(c)->exit_initialization(); });
}

fmi2Status fmi2Terminate(fmi2Component c) {
  return status_of(c, "fmi2Terminate", [&] { instance_of(c)->terminate(); });
}

fmi2Status fmi2Reset(fmi2Component c) {
  return status_of(c, "fmi2Reset", [&] { instance_of(c)->reset(); });
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  return get_values<double>(c, "fmi2GetReal", vr, n, value);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
  return get_values<std::int32_t>(c, "fmi2GetInteger", vr, n, value);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
  return get_values<bool>(c, "fmi2GetBoolean", vr, n, value);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
  return get_values<std::string>(c, "fmi2GetString", vr, n, value);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  return set_values<double>(c, "fmi2SetReal", vr, n, value);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                          const fmi2Integer value[]) {
  return set_values<std::int32_t>(c, "fmi2SetInteger", vr, n, value);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                          const fmi2Boolean value[]) {
  return set_values<bool>(c, "fmi2SetBoolean", vr, n, value);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
  return set_values<std::string>(c, "fmi2SetString", vr, n, value);
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate* state) {
  return status_of(c, "fmi2GetFMUstate", [&] { get_state(*instance_of(c), state); });
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  return status_of(c, "fmi2SetFMUstate", [&] { instance_of(c)->restore(state_of(state)); });
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate* state) {
  return status_of(c, "fmi2FreeFMUstate", [&] { free_state(state); });
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t* size) {
  return status_of(c, "fmi2SerializedFMUstateSize", [&] {
    require(size != nullptr, "an argument is a null pointer");
    *size = instance_of(c)->serialize(state_of(state)).size();
  });
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  return status_of(c, "fmi2SerializeFMUstate", [&] { write_state(*instance_of(c), state, bytes, size); });
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate* state) {
  return status_of(c, "fmi2DeSerializeFMUstate", [&] { read_state(*instance_of(c), bytes, size, state); });
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference[], size_t,
                                        const fmi2ValueReference[], size_t, const fmi2Real[], fmi2Real[]) {
  return unsupported(c, "fmi2GetDirectionalDerivative");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference[], size_t,
                                       const fmi2Integer[], const fmi2Real[]) {
  return unsupported(c, "fmi2SetRealInputDerivatives");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference[], size_t,
                                        const fmi2Integer[], fmi2Real[]) {
  return unsupported(c, "fmi2GetRealOutputDerivatives");
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real current, fmi2Real step, fmi2Boolean) {
  return status_of(c, "fmi2DoStep", [&] { instance_of(c)->do_step(current, step); });
}

fmi2Status fmi2CancelStep(fmi2Component c) { return unsupported(c, "fmi2CancelStep"); }

fmi2Status fmi2GetStatus(fmi2Component, const fmi2StatusKind, fmi2Status*) { return fmi2Discard; }

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real* value) {
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  return status_of(c, "fmi2GetRealStatus", [&] {
    require(value != nullptr, "an argument is a null pointer");
    *value = instance_of(c)->last_successful_time();
  });
}

fmi2Status fmi2GetIntegerStatus(fmi2Component, const fmi2StatusKind, fmi2Integer*) { return fmi2Discard; }

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean* value) {
  if (kind != fmi2Terminated) return fmi2Discard;
  return status_of(c, "fmi2GetBooleanStatus", [&] {
    require(value != nullptr, "an argument is a null pointer");
    *value = fmi2False;
  });
}

fmi2Status fmi2GetStringStatus(fmi2Component, const fmi2StatusKind, fmi2String*) { return fmi2Discard; }

}  // extern "C"
