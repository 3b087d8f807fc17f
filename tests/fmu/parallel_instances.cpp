// robotcell-parallel: instances in parallel threads must be bit-identical to serial ones.
//
// robotcell-parallel THREADS ROUNDS RESOURCES...   every thread creates, steps and frees ROUNDS instances of
// each resource folder. The exit code reports a difference; races are reported by a sanitizer.
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "fmu/fmi/cell_instance.h"

extern "C" {
#include "fmu/third_party/fmi/fmi3Functions.h"
}

namespace {

using Values = std::vector<double>;

void no_log(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String) {}

/// Data that an importer reads from the model description.
struct Fmu {
  std::string resources, token;
  std::map<std::string, fmi3ValueReference> references;
  std::vector<fmi3ValueReference> outputs;

  explicit Fmu(const std::string& folder) : resources(folder) {
    const auto layout = robotcell::layout_of(robotcell::fmi::load_cell(folder + "/cell.json")->description);
    robotcell::fmi::Values values(layout);
    const robotcell::fmi::VariableTable table(layout, values);
    token = table.token(false);
    for (std::size_t i = 0; i < table.variables().size(); ++i) {
      const auto& variable = table.variables()[i];
      references[variable.name] = static_cast<fmi3ValueReference>(i);
      if (variable.causality == robotcell::fmi::Causality::kOutput &&
          variable.type == robotcell::fmi::Type::kReal) {
        outputs.push_back(static_cast<fmi3ValueReference>(i));
      }
    }
  }
};

void require(fmi3Status status, const char* call) {
  if (status != fmi3OK) {
    std::fprintf(stderr, "%s failed\n", call);
    std::exit(1);
  }
}

/// Rotates the table and fires the sensor; returns all real outputs at the end.
Values run(const Fmu& fmu) {
  fmi3Instance cell = fmi3InstantiateCoSimulation("cell", fmu.token.c_str(), fmu.resources.c_str(), false,
                                                  true, false, false, nullptr, 0, nullptr, no_log, nullptr);
  if (cell == nullptr) require(fmi3Error, "fmi3InstantiateCoSimulation");
  require(fmi3EnterInitializationMode(cell, false, 0, 0, false, 0), "fmi3EnterInitializationMode");
  require(fmi3ExitInitializationMode(cell), "fmi3ExitInitializationMode");
  const fmi3ValueReference modes[] = {fmu.references.at("command.mode"),
                                      fmu.references.at("command.trigger.mode")};
  const fmi3Int64 both_on[] = {1, 1};
  require(fmi3SetInt64(cell, modes, 2, both_on, 2), "fmi3SetInt64");
  const fmi3ValueReference reals[] = {fmu.references.at("command.table"),
                                      fmu.references.at("command.trigger.period")};
  double time = 0;
  for (int k = 0; k < 20; ++k) {
    const fmi3Float64 values[] = {0.02 * k, 0.01};
    require(fmi3SetFloat64(cell, reals, 2, values, 2), "fmi3SetFloat64");
    fmi3Boolean flags[3];
    require(fmi3DoStep(cell, time, 0.008, true, &flags[0], &flags[1], &flags[2], &time), "fmi3DoStep");
  }
  Values end(fmu.outputs.size());
  require(fmi3GetFloat64(cell, fmu.outputs.data(), end.size(), end.data(), end.size()), "fmi3GetFloat64");
  fmi3FreeInstance(cell);
  return end;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "usage: robotcell-parallel THREADS ROUNDS RESOURCES...\n");
    return 2;
  }
  const std::vector<Fmu> fmus(argv + 3, argv + argc);
  std::vector<Values> alone;
  for (const Fmu& fmu : fmus) alone.push_back(run(fmu));
  std::atomic<int> different{0};
  const auto work = [&] {
    for (int round = 0; round < std::atoi(argv[2]); ++round) {
      for (std::size_t i = 0; i < fmus.size(); ++i) different += run(fmus[i]) != alone[i];
    }
  };
  std::vector<std::thread> threads;
  for (int i = 0; i < std::atoi(argv[1]); ++i) threads.emplace_back(work);
  for (std::thread& thread : threads) thread.join();
  std::printf("different from alone: %d\n", different.load());
  return different == 0 ? 0 : 1;
}
