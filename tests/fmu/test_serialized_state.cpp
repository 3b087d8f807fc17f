// States with a valid checksum and invalid values are rejected, and the instance recovers.
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstring>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "fmu/fmi/archive.h"
#include "fmu/fmi/sealed_state.h"
#include "fmu/fmi/snapshot.h"
#include "fmu/fmi/variable_table.h"
#include "fmu/model/description/cell_description.h"

extern "C" {
#include "fmu/third_party/fmi/fmi2Functions.h"
#include "fmu/third_party/fmi/fmi3Functions.h"
}

namespace robotcell::fmi {
namespace {

constexpr double kStep = 1e-3;
const std::string kResources = std::string(SCANCELL_TEST_CELLS) + "/free";

/// A member of a state with values from 0 to `last`.
struct Choice {
  const char* name;
  std::int32_t last;
  std::function<void(Snapshot&, std::int32_t)> set;
};

template <class T, class Member>
Choice choice(const char* name, T last, Member member) {
  return {name, static_cast<std::int32_t>(last), [member](Snapshot& state, std::int32_t value) {
            auto& chosen = member(state);
            chosen = static_cast<std::remove_reference_t<decltype(chosen)>>(value);
          }};
}

std::vector<Choice> choices() {
  using S = Snapshot;
  constexpr auto kLastError =
      static_cast<control::ControllerError>(enumeration_of<control::ControllerError>.count - 1);
  return {
      choice("phase", Phase::kEvent, [](S& s) -> decltype(auto) { return (s.phase); }),
      choice("mode command", control::Mode::kProgram,
             [](S& s) -> decltype(auto) { return (s.inputs.motion.mode); }),
      choice("operation command", control::Operation::kAutomatic,
             [](S& s) -> decltype(auto) { return (s.inputs.motion.operation); }),
      choice("jog frame command", control::JogFrame::kTool,
             [](S& s) -> decltype(auto) { return (s.inputs.motion.jog_frame); }),
      choice("trigger command", TriggerMode::kBeltTravel,
             [](S& s) -> decltype(auto) { return (s.inputs.trigger.mode); }),
      choice("gripper command", GripperMode::kForce,
             [](S& s) -> decltype(auto) { return (s.inputs.gripper.mode); }),
      choice("trigger", TriggerMode::kBeltTravel,
             [](S& s) -> decltype(auto) { return (s.cell->trigger.command.mode); }),
      choice("trigger gate", TriggerGate::kPassed,
             [](S& s) -> decltype(auto) { return (s.cell->trigger.gate); }),
      choice("pending motion", control::Mode::kProgram,
             [](S& s) -> decltype(auto) { return (s.cell->controller.pending_move.mode); }),
      choice("gripper mode", GripperMode::kForce,
             [](S& s) -> decltype(auto) { return (s.cell->world.grasp.gripper.command.mode); }),
      choice("mode", control::Mode::kProgram,
             [](S& s) -> decltype(auto) { return (s.cell->controller.mode); }),
      choice("phase of the controller", control::Phase::kEmergencyStop,
             [](S& s) -> decltype(auto) { return (s.cell->controller.phase); }),
      choice("error", kLastError, [](S& s) -> decltype(auto) { return (s.cell->controller.error); }),
      choice("error of the path", kLastError,
             [](S& s) -> decltype(auto) { return (s.cell->controller.path_error); }),
      choice("error of the jog", kLastError,
             [](S& s) -> decltype(auto) { return (s.cell->controller.jog.error); }),
      choice("limit of the jog", kAxes,
             [](S& s) -> decltype(auto) { return (s.cell->controller.jog.limit); }),
      choice("limit of the path", kAxes,
             [](S& s) -> decltype(auto) { return (s.cell->controller.path_limit); }),
      choice("limit of the set-point", kAxes,
             [](S& s) -> decltype(auto) { return (s.cell->controller.servo.limit); }),
  };
}

std::string token() {
  const CellLayout layout = layout_of(parse_cell(read_text_file(kResources + "/cell.json")));
  Values values(layout);
  return VariableTable(layout, values).token(false);
}

/// Calls that a state needs, in one FMI version; true for OK.
class Importer2 {
 public:
  Importer2()
      : cell_(fmi2Instantiate("cell", fmi2CoSimulation, token().c_str(), kResources.c_str(), nullptr,
                              fmi2False, fmi2False)) {
    fmi2SetupExperiment(cell_, fmi2False, 0, 0, fmi2False, 0);
    fmi2EnterInitializationMode(cell_);
    fmi2ExitInitializationMode(cell_);
  }
  ~Importer2() { fmi2FreeInstance(cell_); }
  bool step(double time) { return fmi2DoStep(cell_, time, kStep, fmi2True) == fmi2OK; }
  bool get(void** state) { return fmi2GetFMUstate(cell_, state) == fmi2OK; }
  bool set(void* state) { return fmi2SetFMUstate(cell_, state) == fmi2OK; }
  bool read(const std::vector<std::uint8_t>& bytes, void** state) {
    const auto* data = reinterpret_cast<const fmi2Byte*>(bytes.data());
    return fmi2DeSerializeFMUstate(cell_, data, bytes.size(), state) == fmi2OK;
  }
  bool free(void** state) { return fmi2FreeFMUstate(cell_, state) == fmi2OK; }

 private:
  fmi2Component cell_;
};

void no_log(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String) {}

class Importer3 {
 public:
  Importer3()
      : cell_(fmi3InstantiateCoSimulation("cell", token().c_str(), kResources.c_str(), false, false, false,
                                          false, nullptr, 0, nullptr, no_log, nullptr)) {
    fmi3EnterInitializationMode(cell_, false, 0, 0, false, 0);
    fmi3ExitInitializationMode(cell_);
  }
  ~Importer3() { fmi3FreeInstance(cell_); }
  bool step(double time) {
    bool event = false, terminate = false, early = false;
    double last = 0;
    return fmi3DoStep(cell_, time, kStep, true, &event, &terminate, &early, &last) == fmi3OK;
  }
  bool get(void** state) { return fmi3GetFMUState(cell_, state) == fmi3OK; }
  bool set(void* state) { return fmi3SetFMUState(cell_, state) == fmi3OK; }
  bool read(const std::vector<std::uint8_t>& bytes, void** state) {
    return fmi3DeserializeFMUState(cell_, bytes.data(), bytes.size(), state) == fmi3OK;
  }
  bool free(void** state) { return fmi3FreeFMUState(cell_, state) == fmi3OK; }

 private:
  fmi3Instance cell_;
};

template <class Importer>
class SerializedState : public ::testing::Test {};

using Importers = ::testing::Types<Importer2, Importer3>;
TYPED_TEST_SUITE(SerializedState, Importers);

TYPED_TEST(SerializedState, RejectsInvalidEnumerationValues) {
  TypeParam importer;
  ASSERT_TRUE(importer.step(0));
  void* good = nullptr;
  ASSERT_TRUE(importer.get(&good));
  constexpr std::int32_t kMin = std::numeric_limits<std::int32_t>::min();
  constexpr std::int32_t kMax = std::numeric_limits<std::int32_t>::max();
  for (const Choice& choice : choices()) {
    SCOPED_TRACE(choice.name);
    const auto bytes_with = [&](std::int32_t value) {
      Snapshot state = *static_cast<Snapshot*>(good);
      choice.set(state, value);
      return serialize(state, token());
    };
    void* state = nullptr;
    for (const std::int32_t value : {0, choice.last}) {
      EXPECT_TRUE(importer.read(bytes_with(value), &state)) << value;
      EXPECT_TRUE(importer.free(&state));
    }
    for (const std::int32_t value : {-1, choice.last + 1, kMin, kMax}) {
      EXPECT_FALSE(importer.read(bytes_with(value), &state)) << value;
      EXPECT_EQ(state, nullptr);
      EXPECT_FALSE(importer.step(kStep)) << "after an error only a state or a reset helps";
      EXPECT_TRUE(importer.set(good));
      EXPECT_TRUE(importer.step(kStep));
    }
  }
  EXPECT_TRUE(importer.free(&good));
}

/// A change that makes a state invalid.
struct Fault {
  const char* name;
  std::function<void(Snapshot&)> make;
};

std::vector<Fault> faults() {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  return {
      {"communication time that is not a number", [](Snapshot& s) { s.communication_time = kNan; }},
      {"stop time that is not a number", [](Snapshot& s) { s.stop_time = kNan; }},
      {"communication time other than that of the cell", [](Snapshot& s) { s.communication_time += 1; }},
      {"a cell time far in the past", [](Snapshot& s) { s.cell->time_us = -1'000'000'000'000; }},
      {"a time outside the dynamics step", [](Snapshot& s) { s.cell->to.time_us += 1'000'000; }},
      {"a part position that is not a number",
       [](Snapshot& s) { s.cell->world.parts[0].position[4] = kNan; }},
      {"a part position out of range", [](Snapshot& s) { s.cell->world.parts[0].position[5] = -1e8; }},
      {"a part velocity out of range", [](Snapshot& s) { s.cell->world.parts[0].velocity[3] = 1e300; }},
      {"a part in a frame that the cell does not have",
       [](Snapshot& s) { s.cell->to.parts[0].frame = 1000; }},
      {"a part in such a frame before", [](Snapshot& s) { s.cell->from.parts[0].frame = ~std::size_t{}; }},
      {"an infinite joint position", [](Snapshot& s) { s.cell->to.prescribed.axes.position[2] = kInfinity; }},
      {"a stick constraint with shear",
       [](Snapshot& s) { s.cell->world.parts[0].stick_constraint.support_from_body(0, 1) = 0.1; }},
      {"an orientation that is not normalized",
       [](Snapshot& s) { s.cell->controller.jog.orientation.w() = 2; }},
  };
}

TYPED_TEST(SerializedState, RejectsInconsistentOrNonFiniteValues) {
  TypeParam importer;
  ASSERT_TRUE(importer.step(0));
  void* good = nullptr;
  ASSERT_TRUE(importer.get(&good));
  for (const Fault& fault : faults()) {
    SCOPED_TRACE(fault.name);
    Snapshot wrong = *static_cast<Snapshot*>(good);
    fault.make(wrong);
    void* state = nullptr;
    EXPECT_FALSE(importer.read(serialize(wrong, token()), &state) && importer.set(state));
    EXPECT_TRUE(importer.free(&state));
    EXPECT_TRUE(importer.set(good));
    EXPECT_TRUE(importer.step(kStep));
  }
  EXPECT_TRUE(importer.free(&good));
}

/// Two versions of a structure in a state: the names, order and types of the members make the fingerprint.
struct Version1 {
  double position = 0;
  std::int32_t count = 0;
};
struct Version2 {
  double velocity = 0;
  std::int32_t count = 0;
};
struct Version3 {
  double position = 0;
  std::int64_t count = 0;
};
template <class A>
void exchange(A& a, Version1& v) {
  ROBOTCELL_EXCHANGE(a, v, v.position, v.count);
}
template <class A>
void exchange(A& a, Version2& v) {
  ROBOTCELL_EXCHANGE(a, v, v.velocity, v.count);
}
template <class A>
void exchange(A& a, Version3& v) {
  ROBOTCELL_EXCHANGE(a, v, v.position, v.count);
}

template <class T>
std::uint64_t fingerprint() {
  LayoutHash hash;
  std::vector<T> empty;
  exchange(hash, empty);
  return hash.value();
}

TEST(StateLayout, FingerprintDependsOnNamesAndTypes) {
  EXPECT_EQ(fingerprint<Version1>(), fingerprint<Version1>());
  EXPECT_NE(fingerprint<Version1>(), fingerprint<Version2>());
  EXPECT_NE(fingerprint<Version1>(), fingerprint<Version3>());
}

TEST(StateLayout, StateOfAnotherLayoutIsRejected) {
  Snapshot snapshot({});
  std::vector<std::uint8_t> bytes = serialize(snapshot, "token");
  EXPECT_NO_THROW(deserialize(bytes.data(), bytes.size(), {}, "token"));
  const std::size_t at = sizeof(std::uint64_t) + 5;  // after the length and the characters of the token
  bytes[at] ^= 1u;
  const std::size_t body = bytes.size() - sizeof(std::uint64_t);
  const std::uint64_t checksum = hash_of(bytes.data(), body);
  std::memcpy(bytes.data() + body, &checksum, sizeof checksum);
  try {
    deserialize(bytes.data(), bytes.size(), {}, "token");
    FAIL() << "accepted";
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("another layout"), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("the FMU that saved it"), std::string::npos) << error.what();
  }
}

/// Two threads may serialize one state: it lies on pages that cannot be written.
TEST(StateLayout, SerializingWritesNothingToTheState) {
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  const std::size_t size = (sizeof(Snapshot) / page + 1) * page;
  void* memory = mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  ASSERT_NE(memory, MAP_FAILED);
  auto* state = new (memory) Snapshot({});
  state->stop_time = std::numeric_limits<double>::infinity();
  state->cell.emplace(CellLayout());
  const std::vector<std::uint8_t> expected = serialize(*state, "token");
  ASSERT_EQ(mprotect(memory, size, PROT_READ), 0);
  EXPECT_EQ(serialize(*state, "token"), expected);
  ASSERT_EQ(mprotect(memory, size, PROT_READ | PROT_WRITE), 0);
  state->~Snapshot();
  munmap(memory, size);
}

/// A member of another type does not become a variable.
template <class T, class = void>
struct HasType : std::false_type {};
template <class T>
struct HasType<T, std::void_t<decltype(TypeOf<T>::value)>> : std::true_type {};
static_assert(HasType<double>::value && HasType<std::int32_t>::value && HasType<bool>::value &&
              HasType<std::string>::value);
static_assert(!HasType<std::int64_t>::value && !HasType<float>::value && !HasType<const char*>::value);

}  // namespace
}  // namespace robotcell::fmi
