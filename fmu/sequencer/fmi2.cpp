// Entry points of FMI 2.0 for co-simulation of the sequencer.
#include <memory>
#include <stdexcept>
#include <string>

#include "fmu/fmi/resource_location.h"
#include "fmu/sequencer/sequencer.h"

extern "C" {
#include "fmu/third_party/fmi/fmi2Functions.h"
}

namespace {

using robotcell::sequencer::Sequencer;

struct Component {
  std::string name;
  const fmi2CallbackFunctions* functions;
  std::unique_ptr<Sequencer> sequencer;

  void log_error(const std::string& message) const {
    if (functions == nullptr || functions->logger == nullptr) return;
    functions->logger(functions->componentEnvironment, name.c_str(), fmi2Error, "logStatusError", "%s",
                      message.c_str());
  }
};

Sequencer& sequencer_of(fmi2Component c) { return *static_cast<Component*>(c)->sequencer; }

/// Runs one call of the importer: no exception passes the C interface.
template <class Call>
fmi2Status status_of(fmi2Component c, const char* function, const Call& call) noexcept {
  if (c == nullptr) return fmi2Error;
  try {
    try {
      call(sequencer_of(c));
      return fmi2OK;
    } catch (const std::exception& error) {
      sequencer_of(c).fail();
      static_cast<Component*>(c)->log_error(std::string(function) + ": " + error.what());
    }
  } catch (...) {
    sequencer_of(c).fail();
  }
  return fmi2Error;
}

template <class T, class Value>
fmi2Status get_values(fmi2Component c, const char* function, const fmi2ValueReference vr[], size_t n,
                      Value values[]) {
  return status_of(c, function, [&](const Sequencer& sequencer) {
    if (n > 0 && (vr == nullptr || values == nullptr)) throw std::invalid_argument("a null pointer");
    for (size_t i = 0; i < n; ++i) {
      if constexpr (std::is_same_v<T, std::string>) {
        values[i] = sequencer.get<T>(vr[i]).c_str();
      } else {
        values[i] = sequencer.get<T>(vr[i]);
      }
    }
  });
}

template <class T, class Value>
fmi2Status set_values(fmi2Component c, const char* function, const fmi2ValueReference vr[], size_t n,
                      const Value values[]) {
  return status_of(c, function, [&](Sequencer& sequencer) {
    if (n > 0 && (vr == nullptr || values == nullptr)) throw std::invalid_argument("a null pointer");
    for (size_t i = 0; i < n; ++i) {
      if constexpr (std::is_pointer_v<Value>) {
        if (values[i] == nullptr) throw std::invalid_argument("a null pointer");
      }
      sequencer.set<T>(vr[i], static_cast<T>(values[i]));
    }
  });
}

fmi2Status unsupported(fmi2Component c, const char* function) {
  return status_of(c, function,
                   [](const Sequencer&) { throw std::logic_error("this function is not supported"); });
}

}  // namespace

extern "C" {

const char* fmi2GetTypesPlatform() { return fmi2TypesPlatform; }

const char* fmi2GetVersion() { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component, fmi2Boolean, size_t, const fmi2String[]) { return fmi2OK; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions* functions, fmi2Boolean, fmi2Boolean) {
  try {
    auto component = std::make_unique<Component>(Component{name == nullptr ? "" : name, functions, nullptr});
    const auto reject = [&component](const std::string& message) {
      component->log_error("fmi2Instantiate: " + message);
      return nullptr;
    };
    if (component->name.empty()) return reject("the instance name is empty");
    if (type != fmi2CoSimulation) return reject("only co-simulation is supported");
    try {
      const std::string folder = robotcell::fmi::resource_folder(resources == nullptr ? "" : resources);
      component->sequencer = std::make_unique<Sequencer>(
          robotcell::parse_cell(robotcell::read_text_file(folder + "/cell.json")));
    } catch (const std::exception& error) {
      return reject(error.what());
    }
    const std::string token = component->sequencer->table().token(false);
    if (guid == nullptr || token != guid) return reject("wrong GUID, expected " + token);
    return component.release();
  } catch (...) {
    return nullptr;
  }
}

void fmi2FreeInstance(fmi2Component c) { delete static_cast<Component*>(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean, fmi2Real, fmi2Real start, fmi2Boolean,
                               fmi2Real) {
  return status_of(c, "fmi2SetupExperiment", [&](Sequencer& sequencer) { sequencer.setup(start); });
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
  return status_of(c, "fmi2EnterInitializationMode",
                   [](Sequencer& sequencer) { sequencer.enter_initialization(); });
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  return status_of(c, "fmi2ExitInitializationMode",
                   [](Sequencer& sequencer) { sequencer.exit_initialization(); });
}

fmi2Status fmi2Terminate(fmi2Component c) {
  return status_of(c, "fmi2Terminate", [](Sequencer& sequencer) { sequencer.terminate(); });
}

fmi2Status fmi2Reset(fmi2Component c) {
  return status_of(c, "fmi2Reset", [](Sequencer& sequencer) { sequencer.reset(); });
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

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate*) { return unsupported(c, "fmi2GetFMUstate"); }

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate) { return unsupported(c, "fmi2SetFMUstate"); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate*) { return unsupported(c, "fmi2FreeFMUstate"); }

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate, size_t*) {
  return unsupported(c, "fmi2SerializedFMUstateSize");
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate, fmi2Byte[], size_t) {
  return unsupported(c, "fmi2SerializeFMUstate");
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte[], size_t, fmi2FMUstate*) {
  return unsupported(c, "fmi2DeSerializeFMUstate");
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
  return status_of(c, "fmi2DoStep", [&](Sequencer& sequencer) { sequencer.do_step(current, step); });
}

fmi2Status fmi2CancelStep(fmi2Component c) { return unsupported(c, "fmi2CancelStep"); }

fmi2Status fmi2GetStatus(fmi2Component, const fmi2StatusKind, fmi2Status*) { return fmi2Discard; }

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real* value) {
  if (c == nullptr || value == nullptr) return fmi2Error;
  if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
  *value = sequencer_of(c).last_successful_time();
  return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component, const fmi2StatusKind, fmi2Integer*) { return fmi2Discard; }

fmi2Status fmi2GetBooleanStatus(fmi2Component, const fmi2StatusKind, fmi2Boolean*) { return fmi2Discard; }

fmi2Status fmi2GetStringStatus(fmi2Component, const fmi2StatusKind, fmi2String*) { return fmi2Discard; }

}  // extern "C"
