// Entry points of FMI 3.0 for events: the clock ticks with every trigger record.
#include "fmu/fmi/fmi3_calls.h"
#include "fmu/fmi/variable_table.h"

using namespace robotcell::fmi;

extern "C" {

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
  return status_of(instance, "fmi3EnterEventMode", [&] { instance_of(instance)->enter_event_mode(); });
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
  return status_of(instance, "fmi3EnterStepMode", [&] { instance_of(instance)->enter_step_mode(); });
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Clock values[]) {
  return status_of(instance, "fmi3GetClock", [&] {
    require(n == 0 || (vr != nullptr && values != nullptr), "an argument is a null pointer");
    for (size_t i = 0; i < n; ++i) {
      require(vr[i] == instance_of(instance)->record_clock_reference(), "the variable is not a clock");
      values[i] = instance_of(instance)->record_clock();
    }
  });
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
  return status_of(instance, "fmi3EvaluateDiscreteStates", [&] { instance_of(instance)->require_event(); });
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean* need_update, fmi3Boolean* terminate,
                                    fmi3Boolean* nominals_changed, fmi3Boolean* values_changed,
                                    fmi3Boolean* next_event_defined, fmi3Float64* next_event) {
  return status_of(instance, "fmi3UpdateDiscreteStates", [&] {
    instance_of(instance)->update_discrete_states();
    for (fmi3Boolean* flag : {need_update, terminate, nominals_changed, values_changed, next_event_defined}) {
      if (flag != nullptr) *flag = fmi3False;
    }
    if (next_event != nullptr) *next_event = 0;
  });
}

}  // extern "C"
