// robotcell-fuzz: random legal and illegal calls of both FMI versions, or many instances in sequence. Fails
// on a crash, a hang, an invalid status, or growing memory.
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <vector>

#ifdef _WIN32
#include <windows.h>
// After windows.h, which it needs.
#include <psapi.h>
#else
#include <unistd.h>
#endif

#include "fmu/fmi/variable_table.h"
#include "fmu/model/description/cell_description.h"

extern "C" {
#include "fmu/third_party/fmi/fmi2Functions.h"
#include "fmu/third_party/fmi/fmi3Functions.h"
}

namespace {

using Bytes = std::vector<unsigned char>;

#ifdef _WIN32
double resident_mb() {
  PROCESS_MEMORY_COUNTERS memory{};
  GetProcessMemoryInfo(GetCurrentProcess(), &memory, sizeof memory);
  return static_cast<double>(memory.WorkingSetSize) / 1e6;
}
#else
double resident_mb() {
  std::ifstream file("/proc/self/statm");
  long pages = 0;
  long resident = 0;
  file >> pages >> resident;
  return static_cast<double>(resident) * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
}
#endif

/// What callbacks know of the instance that calls them, which is null before it exists.
struct Caller {
  int version = 0;
  void* instance = nullptr;
  bool misbehaves = false;  // in intermediate updates: calls other functions than getters
  unsigned count = 0;       // of callbacks
  bool accepted = false;    // whether the instance accepted a call from its log callback
};

/// Whether an instance of FMI 2 refuses a call from its log callback.
bool is_refused2(void* c, unsigned count) {
  const fmi2ValueReference reference = count % 7;
  fmi2Real real = 0.5;
  void* state = nullptr;
  switch (count % 6) {
    case 0:
      return fmi2Reset(c) == fmi2Error;
    case 1:
      return fmi2DoStep(c, 0, 1e-3, fmi2True) == fmi2Error;
    case 2:
      return fmi2GetReal(c, &reference, 1, &real) == fmi2Error;
    case 3:
      return fmi2GetFMUstate(c, &state) == fmi2Error && state == nullptr;
    case 4:
      return fmi2SetReal(c, &reference, 1, &real) == fmi2Error;
    default:
      fmi2FreeInstance(c);
      return true;
  }
}

/// The same in FMI 3.
bool is_refused3(void* c, unsigned count) {
  const fmi3ValueReference reference = count % 7;
  fmi3Float64 real = 0.5;
  fmi3Boolean flags[5] = {};
  void* state = nullptr;
  switch (count % 7) {
    case 0:
      return fmi3Reset(c) == fmi3Error;
    case 1:
      return fmi3DoStep(c, 0, 1e-3, true, &flags[0], &flags[1], &flags[2], &real) == fmi3Error;
    case 2:
      return fmi3GetFloat64(c, &reference, 1, &real, 1) == fmi3Error;
    case 3:
      return fmi3GetFMUState(c, &state) == fmi3Error && state == nullptr;
    case 4:
      return fmi3Terminate(c) == fmi3Error;
    case 5:
      return fmi3UpdateDiscreteStates(c, &flags[0], &flags[1], &flags[2], &flags[3], &flags[4], &real) ==
             fmi3Error;
    default:
      fmi3FreeInstance(c);
      return true;
  }
}

void log2(fmi2ComponentEnvironment environment, fmi2String, fmi2Status, fmi2String, fmi2String, ...) {
  Caller& caller = *static_cast<Caller*>(environment);
  if (caller.instance != nullptr && !is_refused2(caller.instance, caller.count++)) caller.accepted = true;
}

void log3(fmi3InstanceEnvironment environment, fmi3Status, fmi3String, fmi3String) {
  Caller& caller = *static_cast<Caller*>(environment);
  if (caller.instance != nullptr && !is_refused3(caller.instance, caller.count++)) caller.accepted = true;
}

/// An intermediate update, where only getters are allowed, and no call may do harm.
void update3(fmi3InstanceEnvironment environment, fmi3Float64, fmi3Boolean, fmi3Boolean, fmi3Boolean,
             fmi3Boolean, fmi3Boolean* requested, fmi3Float64*) {
  Caller& caller = *static_cast<Caller*>(environment);
  void* c = caller.instance;
  const fmi3ValueReference reference = caller.count++ % 500;
  fmi3Float64 real = 0;
  fmi3GetFloat64(c, &reference, 1, &real, 1);
  *requested = caller.count % 5 == 0;
  if (!caller.misbehaves) return;
  switch (caller.count % 4) {
    case 0:
      fmi3Reset(c);
      break;
    case 1:
      fmi3FreeInstance(c);
      break;
    case 2:
      fmi3Terminate(c);
      break;
    default:
      fmi3SetFMUState(c, nullptr);
  }
}

/// One FMU instance of either version and the states taken from it.
struct Subject {
  int version;
  void* instance;
  std::unique_ptr<Caller> caller;
  std::unique_ptr<fmi2CallbackFunctions> functions;
  double time = 0;
  std::vector<void*> states;
};

robotcell::CellLayout layout_of_cell(const std::string& resources) {
  return robotcell::layout_of(robotcell::parse_cell(robotcell::read_text_file(resources + "/cell.json")));
}

/// Tokens of all variants of a version of FMI; the last one is that with scalars alone.
std::vector<std::string> tokens_of(const std::string& resources, int version) {
  const auto layout = layout_of_cell(resources);
  robotcell::fmi::Values values(layout);
  std::vector<robotcell::fmi::TableOptions> options = robotcell::fmi::table_options(version);
  options.emplace_back();
  std::vector<std::string> tokens;
  for (const robotcell::fmi::TableOptions& variant : options) {
    const robotcell::fmi::VariableTable table(layout, values, variant);
    if (version == 3) tokens.push_back(table.token(true));
    tokens.push_back(table.token(false));
  }
  return tokens;
}

std::size_t table_size(const std::string& resources) {
  const auto layout = layout_of_cell(resources);
  robotcell::fmi::Values values(layout);
  return robotcell::fmi::VariableTable(layout, values).variables().size();
}

class Fuzzer {
 public:
  Fuzzer(unsigned seed, std::vector<std::string> resources)
      : random_(seed),
        resources_(std::move(resources)),
        tokens_{tokens_of(resources_[0], 2), tokens_of(resources_[0], 3)},
        references_(table_size(resources_[0])) {}

  ~Fuzzer() {
    while (!subjects_.empty()) drop(0);
  }

  /// Whether an instance accepted a call from its log callback; frees all instances.
  bool accepted_in_callback() {
    while (!subjects_.empty()) drop(0);
    return accepted_in_callback_;
  }

  /// One random call; true where it succeeded.
  bool call() {
    if (subjects_.size() < 2 || (subjects_.size() < 8 && chance(0.002))) return instantiate();
    const std::size_t index = below(subjects_.size());
    if (chance(0.002)) return drop(index);
    Subject& subject = subjects_[index];
    return subject.version == 2 ? call2(subject) : call3(subject);
  }

 private:
  std::size_t below(std::size_t count) {
    return std::uniform_int_distribution<std::size_t>(0, count - 1)(random_);
  }
  bool chance(double probability) { return std::uniform_real_distribution<>(0, 1)(random_) < probability; }

  std::uint32_t reference() {
    return static_cast<std::uint32_t>(chance(0.95) ? below(references_) : random_());
  }
  double real() {
    constexpr double kSpecial[] = {0,
                                   1e-3,
                                   -1,
                                   1e300,
                                   4,
                                   std::numeric_limits<double>::quiet_NaN(),
                                   std::numeric_limits<double>::infinity(),
                                   5e-324};
    return chance(0.5) ? std::uniform_real_distribution<>(-3, 3)(random_)
                       : kSpecial[below(std::size(kSpecial))];
  }
  int integer() { return chance(0.9) ? static_cast<int>(below(6)) : static_cast<int>(random_()); }
  double step() {
    constexpr double kSizes[] = {1e-3,
                                 1e-3,
                                 40e-6,
                                 0.016,
                                 0.016,
                                 0.1,
                                 0.37e-6,
                                 0,
                                 -1e-3,
                                 1e300,
                                 std::numeric_limits<double>::quiet_NaN()};
    return kSizes[below(std::size(kSizes))];
  }
  double now(const Subject& subject) { return chance(0.97) ? subject.time : real(); }

  bool instantiate() {
    const std::string& resources = resources_[chance(0.9) ? 0 : below(resources_.size())];
    const char* name = chance(0.98) ? "cell" : nullptr;
    const int version = chance(0.5) ? 2 : 3;
    const std::vector<std::string>& known = tokens_[static_cast<std::size_t>(version - 2)];
    const std::string token = chance(0.95) ? known[below(known.size())] : "{else}";
    auto caller = std::make_unique<Caller>();
    caller->version = version;
    caller->misbehaves = chance(0.3);
    auto functions = std::make_unique<fmi2CallbackFunctions>(
        fmi2CallbackFunctions{log2, nullptr, nullptr, nullptr, caller.get()});
    void* instance =
        version == 2
            ? fmi2Instantiate(name, chance(0.98) ? fmi2CoSimulation : fmi2ModelExchange, token.c_str(),
                              resources.c_str(), chance(0.9) ? functions.get() : nullptr, fmi2False, fmi2True)
            : fmi3InstantiateCoSimulation(name, token.c_str(), resources.c_str(), false, true, chance(0.5),
                                          chance(0.5), nullptr, 0, caller.get(), log3,
                                          chance(0.3) ? update3 : nullptr);
    if (instance == nullptr) return false;
    caller->instance = instance;
    subjects_.push_back({version, instance, std::move(caller), std::move(functions), 0, {}});
    return true;
  }

  bool drop(std::size_t index) {
    Subject& subject = subjects_[index];
    accepted_in_callback_ = accepted_in_callback_ || subject.caller->accepted;
    for (void*& state : subject.states) {
      if (subject.version == 2) fmi2FreeFMUstate(subject.instance, &state);
      if (subject.version == 3) fmi3FreeFMUState(subject.instance, &state);
    }
    if (subject.version == 2) fmi2FreeInstance(subject.instance);
    if (subject.version == 3) fmi3FreeInstance(subject.instance);
    subjects_.erase(subjects_.begin() + static_cast<std::ptrdiff_t>(index));
    return true;
  }

  Bytes damaged(Bytes bytes) {
    if (bytes.empty() || chance(0.3)) return bytes;
    if (chance(0.3)) bytes.resize(below(bytes.size()));
    for (int i = 0; i < 3 && !bytes.empty(); ++i)
      bytes[below(bytes.size())] = static_cast<unsigned char>(random_());
    return bytes;
  }

  /// Any state of this FMI version, also of another instance.
  void* some_state(int version) {
    const Subject& owner = subjects_[below(subjects_.size())];
    if (owner.version != version || owner.states.empty()) return nullptr;
    return owner.states[below(owner.states.size())];
  }

  bool call2(Subject& subject) {
    void* c = subject.instance;
    const fmi2ValueReference vr[2] = {reference(), reference()};
    const std::size_t n = below(3);
    fmi2Real reals[2] = {real(), real()};
    fmi2Integer integers[2] = {integer(), integer()};
    fmi2Boolean booleans[2] = {integer(), integer()};
    fmi2String strings[2] = {chance(0.9) ? "cell.json" : "none.json", chance(0.8) ? "cell.json" : nullptr};
    const fmi2String categories[2] = {chance(0.9) ? "logEvents" : "none", chance(0.9) ? "logAll" : nullptr};
    switch (below(chance(0.5) ? 4 : 20)) {
      case 0:
      case 1:
        return stepped(subject, fmi2DoStep(c, now(subject), last_step_ = step(), fmi2True) == fmi2OK);
      case 2:
        return fmi2SetReal(c, vr, n, reals) == fmi2OK;
      case 3:
        return fmi2GetReal(c, vr, n, reals) == fmi2OK;
      case 4:
        return fmi2SetInteger(c, vr, n, integers) == fmi2OK;
      case 5:
        return fmi2GetInteger(c, vr, n, integers) == fmi2OK;
      case 6:
        return fmi2SetBoolean(c, vr, n, booleans) == fmi2OK;
      case 7:
        return fmi2GetBoolean(c, vr, n, booleans) == fmi2OK;
      case 8:
        return fmi2SetString(c, vr, n, strings) == fmi2OK;
      case 9:
        return fmi2GetString(c, chance(0.95) ? vr : nullptr, n, strings) == fmi2OK;
      case 10:
        return fmi2SetupExperiment(c, 0, 0, chance(0.9) ? 0 : real(), chance(0.1), real()) == fmi2OK;
      case 11:
        return fmi2EnterInitializationMode(c) == fmi2OK;
      case 12:
        return fmi2ExitInitializationMode(c) == fmi2OK;
      case 13:
        return chance(0.2) && fmi2Terminate(c) == fmi2OK;
      case 14:
        return reset(subject, fmi2Reset(c) == fmi2OK);
      case 15:
        return set_state(subject, [&](void* state) { return fmi2SetFMUstate(c, state) == fmi2OK; });
      case 16:
        return get_state(
            subject, [&](void** state) { return fmi2GetFMUstate(c, state) == fmi2OK; },
            [&](void** state) { return fmi2FreeFMUstate(c, state) == fmi2OK; });
      case 17:
        return bytes2(subject);
      case 18:
        return fmi2SetDebugLogging(c, chance(0.5), n, categories) == fmi2OK;
      default:
        return chance(0.1) && fmi2CancelStep(c) == fmi2OK;
    }
  }

  bool call3(Subject& subject) {
    void* c = subject.instance;
    const fmi3ValueReference vr[2] = {reference(), reference()};
    const std::size_t n = below(3);
    fmi3Float64 reals[2] = {real(), real()};
    fmi3Int32 integers[2] = {integer(), integer()};
    fmi3Int64 members[2] = {chance(0.9) ? integer() : 1LL << 40, integer()};
    fmi3Boolean booleans[2] = {chance(0.5), chance(0.5)};
    fmi3Boolean flags[5] = {};
    fmi3String strings[2] = {chance(0.9) ? "cell.json" : "none.json", chance(0.8) ? "cell.json" : nullptr};
    const fmi3String categories[2] = {chance(0.9) ? "logEvents" : "none", chance(0.9) ? "logAll" : nullptr};
    const std::size_t m = chance(0.97) ? n : below(3);
    switch (below(chance(0.5) ? 4 : 25)) {
      case 0:
      case 1:
        return stepped(subject, fmi3DoStep(c, now(subject), last_step_ = step(), true, &flags[0], &flags[1],
                                           &flags[2], &subject.time) == fmi3OK);
      case 2:
        return fmi3SetFloat64(c, vr, n, reals, m) == fmi3OK;
      case 3:
        return fmi3GetFloat64(c, vr, n, reals, m) == fmi3OK;
      case 4:
        if (chance(0.5)) return fmi3SetInt64(c, vr, n, members, m) == fmi3OK;
        return fmi3SetInt32(c, vr, n, integers, m) == fmi3OK;
      case 5:
        if (chance(0.5)) return fmi3GetInt64(c, vr, n, members, m) == fmi3OK;
        return fmi3GetInt32(c, vr, n, integers, m) == fmi3OK;
      case 6:
        return fmi3SetBoolean(c, vr, n, booleans, m) == fmi3OK;
      case 7:
        return fmi3GetBoolean(c, vr, n, booleans, m) == fmi3OK;
      case 8:
        return fmi3SetString(c, vr, n, strings, m) == fmi3OK;
      case 9:
        return fmi3GetString(c, chance(0.95) ? vr : nullptr, n, strings, m) == fmi3OK;
      case 10:
      case 11:
        return fmi3EnterInitializationMode(c, false, 0, chance(0.9) ? 0 : real(), chance(0.1), real()) ==
               fmi3OK;
      case 12:
      case 13:
        return fmi3ExitInitializationMode(c) == fmi3OK;
      case 14:
        return chance(0.2) && fmi3Terminate(c) == fmi3OK;
      case 15:
        return reset(subject, fmi3Reset(c) == fmi3OK);
      case 16:
        return set_state(subject, [&](void* state) { return fmi3SetFMUState(c, state) == fmi3OK; });
      case 17:
        return get_state(
            subject, [&](void** state) { return fmi3GetFMUState(c, state) == fmi3OK; },
            [&](void** state) { return fmi3FreeFMUState(c, state) == fmi3OK; });
      case 18:
        return bytes3(subject);
      case 19:
        return fmi3EnterEventMode(c) == fmi3OK;
      case 20:
        return fmi3EnterStepMode(c) == fmi3OK;
      case 21:
        return fmi3UpdateDiscreteStates(c, &flags[0], &flags[1], &flags[2], &flags[3], &flags[4], reals) ==
               fmi3OK;
      case 22:
        return fmi3GetClock(c, vr, n, booleans) == fmi3OK;
      case 23:
        return fmi3SetDebugLogging(c, chance(0.5), n, categories) == fmi3OK;
      default:
        return chance(0.1) && fmi3EnterConfigurationMode(c) == fmi3OK;
    }
  }

  bool stepped(Subject& subject, bool accepted) {
    if (accepted && subject.version == 2) subject.time += last_step_;
    return accepted;
  }

  static bool reset(Subject& subject, bool accepted) {
    if (accepted) subject.time = 0;
    return accepted;
  }

  bool set_state(Subject& subject, const std::function<bool(void*)>& set) {
    void* state = some_state(subject.version);
    if (!set(state)) return false;
    if (subject.version == 2) fmi2GetRealStatus(subject.instance, fmi2LastSuccessfulTime, &subject.time);
    return true;
  }

  bool get_state(Subject& subject, const std::function<bool(void**)>& get,
                 const std::function<bool(void**)>& free) {
    if (subject.states.size() < 4) {
      void* state = nullptr;
      if (!get(&state)) return false;
      subject.states.push_back(state);
      return true;
    }
    const std::size_t index = below(subject.states.size());
    if (chance(0.5)) return get(&subject.states[index]);
    const bool freed = free(&subject.states[index]);
    subject.states.erase(subject.states.begin() + static_cast<std::ptrdiff_t>(index));
    return freed;
  }

  bool bytes2(Subject& subject) {
    void* c = subject.instance;
    void* state = some_state(2);
    std::size_t size = 0;
    if (fmi2SerializedFMUstateSize(c, state, &size) != fmi2OK) return false;
    Bytes bytes(size);
    auto* data = reinterpret_cast<fmi2Byte*>(bytes.data());
    if (fmi2SerializeFMUstate(c, state, data, chance(0.9) ? size : size / 2) != fmi2OK) return false;
    bytes = damaged(std::move(bytes));
    void* read = nullptr;
    if (fmi2DeSerializeFMUstate(c, reinterpret_cast<fmi2Byte*>(bytes.data()), bytes.size(), &read) !=
        fmi2OK) {
      return false;
    }
    return fmi2FreeFMUstate(c, &read) == fmi2OK;
  }

  bool bytes3(Subject& subject) {
    void* c = subject.instance;
    void* state = some_state(3);
    std::size_t size = 0;
    if (fmi3SerializedFMUStateSize(c, state, &size) != fmi3OK) return false;
    Bytes bytes(size);
    if (fmi3SerializeFMUState(c, state, bytes.data(), chance(0.9) ? size : size / 2) != fmi3OK) return false;
    bytes = damaged(std::move(bytes));
    void* read = nullptr;
    if (fmi3DeserializeFMUState(c, bytes.data(), bytes.size(), &read) != fmi3OK) return false;
    return fmi3FreeFMUState(c, &read) == fmi3OK;
  }

  std::mt19937 random_;
  std::vector<std::string> resources_;
  std::array<std::vector<std::string>, 2> tokens_;  // of FMI 2 and 3
  std::size_t references_;                          // of the first cell
  std::vector<Subject> subjects_;
  double last_step_ = 0;
  bool accepted_in_callback_ = false;
};

/// Random calls; returns the growth of memory (MB) over the last four fifths.
double fuzz(long calls, unsigned seed, const std::vector<std::string>& resources) {
  Fuzzer fuzzer(seed, resources);
  long accepted = 0;
  double early = 0;
  for (long i = 0; i < calls; ++i) {
    if (fuzzer.call()) ++accepted;
    if (i == calls / 5) early = resident_mb();
  }
  const double growth = resident_mb() - early;
  if (fuzzer.accepted_in_callback()) {
    std::fprintf(stderr, "a call from a log callback was accepted\n");
    std::exit(1);
  }
  std::printf("calls %ld accepted %ld growth_mb %.3f\n", calls, accepted, growth);
  return growth;
}

/// Creates, initialises and steps instances in sequence; returns the growth of memory (MB) after a warm-up of
/// a tenth as many.
double cycle(long cycles, const std::string& resources) {
  const std::string token = tokens_of(resources, 2).back();
  double early = 0;
  for (long i = -cycles / 10; i < cycles; ++i) {
    void* instance = nullptr;
    bool fine = false;
    if (i % 2 == 0) {
      instance = fmi2Instantiate("cell", fmi2CoSimulation, token.c_str(), resources.c_str(), nullptr, 0, 0);
      fine = fmi2EnterInitializationMode(instance) == fmi2OK &&
             fmi2ExitInitializationMode(instance) == fmi2OK && fmi2DoStep(instance, 0, 0.004, 1) == fmi2OK;
      fmi2FreeInstance(instance);
    } else {
      instance = fmi3InstantiateCoSimulation("cell", token.c_str(), resources.c_str(), false, false, false,
                                             false, nullptr, 0, nullptr, nullptr, nullptr);
      fmi3Boolean flags[3];
      double reached = 0;
      fine = fmi3EnterInitializationMode(instance, false, 0, 0, false, 0) == fmi3OK &&
             fmi3ExitInitializationMode(instance) == fmi3OK &&
             fmi3DoStep(instance, 0, 0.004, true, &flags[0], &flags[1], &flags[2], &reached) == fmi3OK;
      fmi3FreeInstance(instance);
    }
    if (!fine) {
      std::fprintf(stderr, "instance %ld failed\n", i);
      return std::numeric_limits<double>::infinity();
    }
    if (i == 0) early = resident_mb();
  }
  const double growth = resident_mb() - early;
  std::printf("cycles %ld growth_mb %.3f\n", cycles, growth);
  return growth;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 5) {
    std::fprintf(stderr, "usage: robotcell-fuzz calls|cycles COUNT SEED RESOURCES...\n");
    return 2;
  }
  const long count = std::atol(argv[2]);
  const std::vector<std::string> resources(argv + 4, argv + argc);
  const bool cycles = std::strcmp(argv[1], "cycles") == 0;
  const double growth =
      cycles ? cycle(count, resources[0]) : fuzz(count, static_cast<unsigned>(std::atol(argv[3])), resources);
  return std::isfinite(growth) ? 0 : 1;
}
