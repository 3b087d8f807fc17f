/* Plays a list of FMI calls, on Linux and Windows: FMI 2 or 3, values in, a table of outputs out.

   cc -std=c11 -I fmu/third_party/fmi tests/fmu/call_player.c -o call_player -ldl
   x86_64-w64-mingw32-gcc -std=c11 -I fmu/third_party/fmi tests/fmu/call_player.c -o call_player.exe
   call_player 2|3 BINARY RESOURCES TOKEN CALLS >TABLE

   CALLS is a file with a call in each line:
     columns r12 i7 e9 b3   what `row` writes: type (real, integer, enumeration, Boolean) and reference
     set r12 0.5            set an input, before `start` a parameter
     start                  end the initialization
     row                    write the time and the values of the columns
     step 0.016             one step
     save FILE, load FILE   serialized state; after `load` the time is that of the last `time`
     time 1.5
   The last line on stderr is the number of steps and the processor time of all calls in CALLS. */
#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#ifdef _WIN32
#include <windows.h>
static void* open_library(const char* path) {
  return (void*)LoadLibraryExA(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
}
static void* symbol(void* library, const char* name) { return (void*)GetProcAddress((HMODULE)library, name); }
static double processor_seconds(void) {
  FILETIME created, ended, kernel, user;
  GetProcessTimes(GetCurrentProcess(), &created, &ended, &kernel, &user);
  return 1e-7 * (4294967296.0 * (kernel.dwHighDateTime + user.dwHighDateTime) + kernel.dwLowDateTime +
                 user.dwLowDateTime);
}
#else
#include <dlfcn.h>
static void* open_library(const char* path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void* symbol(void* library, const char* name) { return dlsym(library, name); }
static double processor_seconds(void) { return (double)clock() / CLOCKS_PER_SEC; }
#endif

#define ENTRY(name) name##TYPE* name = (name##TYPE*)entry(#name)
#define MAX_COLUMNS 4096

static void* library;
static void* instance;
static int version;
static double now;  // s
static char types[MAX_COLUMNS];
static unsigned references[MAX_COLUMNS];
static size_t columns;

static void fail(const char* what, const char* why) {
  fprintf(stderr, "call_player: %s: %s\n", what, why);
  exit(1);
}

static void check(int status, const char* what) {
  if (status > 1) fail(what, "the FMU reports an error");  // 0: fine, 1: warning, in both versions
}

static void* entry(const char* name) {
  void* found = symbol(library, name);
  if (!found) fail(name, "no such function in the binary");
  return found;
}

static void write_log2(void* environment, fmi2String name, fmi2Status status, fmi2String category,
                       fmi2String format, ...) {
  va_list values;
  (void)environment, (void)name, (void)status;
  fprintf(stderr, "%s: ", category);
  va_start(values, format);
  vfprintf(stderr, format, values);
  va_end(values);
  fputc('\n', stderr);
}

static void write_log3(void* environment, fmi3Status status, fmi3String category, fmi3String message) {
  (void)environment, (void)status;
  fprintf(stderr, "%s: %s\n", category, message);
}

static void instantiate(const char* token, const char* resources) {
  if (version == 2) {
    ENTRY(fmi2Instantiate);
    static const fmi2CallbackFunctions callbacks = {write_log2, calloc, free, NULL, NULL};
    instance = fmi2Instantiate("cell", fmi2CoSimulation, token, resources, &callbacks, 0, 0);
  } else {
    ENTRY(fmi3InstantiateCoSimulation);
    instance =
        fmi3InstantiateCoSimulation("cell", token, resources, 0, 0, 0, 0, NULL, 0, NULL, write_log3, NULL);
  }
  if (!instance) fail(resources, "the FMU cannot be instantiated");
}

static void initialize(void) {
  if (version == 2) {
    ENTRY(fmi2SetupExperiment);
    ENTRY(fmi2EnterInitializationMode);
    ENTRY(fmi2ExitInitializationMode);
    check(fmi2SetupExperiment(instance, 0, 0, 0, 0, 0), "fmi2SetupExperiment");
    check(fmi2EnterInitializationMode(instance), "fmi2EnterInitializationMode");
    check(fmi2ExitInitializationMode(instance), "fmi2ExitInitializationMode");
  } else {
    ENTRY(fmi3EnterInitializationMode);
    ENTRY(fmi3ExitInitializationMode);
    check(fmi3EnterInitializationMode(instance, 0, 0, 0, 0, 0), "fmi3EnterInitializationMode");
    check(fmi3ExitInitializationMode(instance), "fmi3ExitInitializationMode");
  }
}

static double get(char type, unsigned reference) {
  double real = 0;
  if (version == 2) {
    ENTRY(fmi2GetReal);
    ENTRY(fmi2GetInteger);
    ENTRY(fmi2GetBoolean);
    int integer = 0;
    if (type == 'r') check(fmi2GetReal(instance, &reference, 1, &real), "fmi2GetReal");
    if (type == 'b') check(fmi2GetBoolean(instance, &reference, 1, &integer), "fmi2GetBoolean");
    if (type == 'i' || type == 'e')
      check(fmi2GetInteger(instance, &reference, 1, &integer), "fmi2GetInteger");
    return type == 'r' ? real : integer;
  }
  ENTRY(fmi3GetFloat64);
  ENTRY(fmi3GetInt32);
  ENTRY(fmi3GetInt64);
  ENTRY(fmi3GetBoolean);
  fmi3Int32 integer = 0;
  fmi3Int64 member = 0;
  fmi3Boolean flag = 0;
  if (type == 'r') check(fmi3GetFloat64(instance, &reference, 1, &real, 1), "fmi3GetFloat64");
  if (type == 'i') check(fmi3GetInt32(instance, &reference, 1, &integer, 1), "fmi3GetInt32");
  if (type == 'e') check(fmi3GetInt64(instance, &reference, 1, &member, 1), "fmi3GetInt64");
  if (type == 'b') check(fmi3GetBoolean(instance, &reference, 1, &flag, 1), "fmi3GetBoolean");
  return type == 'r' ? real : type == 'i' ? integer : type == 'e' ? (double)member : flag;
}

static void set(char type, unsigned reference, double real) {
  const int integer = (int)real;
  if (version == 2) {
    ENTRY(fmi2SetReal);
    ENTRY(fmi2SetInteger);
    ENTRY(fmi2SetBoolean);
    if (type == 'r') check(fmi2SetReal(instance, &reference, 1, &real), "fmi2SetReal");
    if (type == 'b') check(fmi2SetBoolean(instance, &reference, 1, &integer), "fmi2SetBoolean");
    if (type == 'i' || type == 'e')
      check(fmi2SetInteger(instance, &reference, 1, &integer), "fmi2SetInteger");
    return;
  }
  ENTRY(fmi3SetFloat64);
  ENTRY(fmi3SetInt32);
  ENTRY(fmi3SetInt64);
  ENTRY(fmi3SetBoolean);
  const fmi3Int64 member = integer;
  const fmi3Boolean flag = integer != 0;
  if (type == 'r') check(fmi3SetFloat64(instance, &reference, 1, &real, 1), "fmi3SetFloat64");
  if (type == 'i') check(fmi3SetInt32(instance, &reference, 1, &integer, 1), "fmi3SetInt32");
  if (type == 'e') check(fmi3SetInt64(instance, &reference, 1, &member, 1), "fmi3SetInt64");
  if (type == 'b') check(fmi3SetBoolean(instance, &reference, 1, &flag, 1), "fmi3SetBoolean");
}

static void step(double size) {
  if (version == 2) {
    ENTRY(fmi2DoStep);
    check(fmi2DoStep(instance, now, size, 1), "fmi2DoStep");
  } else {
    ENTRY(fmi3DoStep);
    fmi3Boolean event = 0, terminate = 0, early = 0;
    double reached = 0;
    check(fmi3DoStep(instance, now, size, 1, &event, &terminate, &early, &reached), "fmi3DoStep");
  }
  now += size;
}

static void save(const char* path) {
  void* state = NULL;
  size_t size = 0;
  char* bytes = NULL;
  if (version == 2) {
    ENTRY(fmi2GetFMUstate);
    ENTRY(fmi2SerializedFMUstateSize);
    ENTRY(fmi2SerializeFMUstate);
    check(fmi2GetFMUstate(instance, &state), "fmi2GetFMUstate");
    check(fmi2SerializedFMUstateSize(instance, state, &size), "fmi2SerializedFMUstateSize");
    bytes = malloc(size);
    check(fmi2SerializeFMUstate(instance, state, bytes, size), "fmi2SerializeFMUstate");
  } else {
    ENTRY(fmi3GetFMUState);
    ENTRY(fmi3SerializedFMUStateSize);
    ENTRY(fmi3SerializeFMUState);
    check(fmi3GetFMUState(instance, &state), "fmi3GetFMUState");
    check(fmi3SerializedFMUStateSize(instance, state, &size), "fmi3SerializedFMUStateSize");
    bytes = malloc(size);
    check(fmi3SerializeFMUState(instance, state, (fmi3Byte*)bytes, size), "fmi3SerializeFMUState");
  }
  FILE* file = fopen(path, "wb");
  if (!file || fwrite(bytes, 1, size, file) != size || fclose(file)) fail(path, "cannot be written");
  free(bytes);
}

static void load(const char* path) {
  static char bytes[1 << 24];
  FILE* file = fopen(path, "rb");
  if (!file) fail(path, "cannot be read");
  const size_t size = fread(bytes, 1, sizeof bytes, file);
  fclose(file);
  void* state = NULL;
  if (version == 2) {
    ENTRY(fmi2DeSerializeFMUstate);
    ENTRY(fmi2SetFMUstate);
    check(fmi2DeSerializeFMUstate(instance, bytes, size, &state), "fmi2DeSerializeFMUstate");
    check(fmi2SetFMUstate(instance, state), "fmi2SetFMUstate");
  } else {
    ENTRY(fmi3DeserializeFMUState);
    ENTRY(fmi3SetFMUState);
    check(fmi3DeserializeFMUState(instance, (fmi3Byte*)bytes, size, &state), "fmi3DeserializeFMUState");
    check(fmi3SetFMUState(instance, state), "fmi3SetFMUState");
  }
}

static void choose_columns(char* word) {
  for (columns = 0; (word = strtok(NULL, " ")); ++columns) {
    if (columns == MAX_COLUMNS) fail("columns", "too many");
    types[columns] = word[0];
    references[columns] = (unsigned)strtoul(word + 1, NULL, 10);
  }
}

static void write_row(void) {
  printf("%.17g", now);
  for (size_t i = 0; i < columns; ++i) printf(",%.17g", get(types[i], references[i]));
  putchar('\n');
}

static void play(FILE* calls) {
  static char line[1 << 20];
  long steps = 0;
  const double start = processor_seconds();
  while (fgets(line, sizeof line, calls)) {
    line[strcspn(line, "\r\n")] = 0;
    char* word = strtok(line, " ");
    if (!word) continue;
    if (!strcmp(word, "columns")) {
      choose_columns(word);
    } else if (!strcmp(word, "start")) {
      initialize();
    } else if (!strcmp(word, "row")) {
      write_row();
    } else {
      const char* first = strtok(NULL, " ");
      if (!first) fail(word, "expected an argument");
      if (!strcmp(word, "set")) {
        set(first[0], (unsigned)strtoul(first + 1, NULL, 10), strtod(strtok(NULL, " "), NULL));
      } else if (!strcmp(word, "step")) {
        step(strtod(first, NULL));
        ++steps;
      } else if (!strcmp(word, "save")) {
        save(first);
      } else if (!strcmp(word, "load")) {
        load(first);
      } else if (!strcmp(word, "time")) {
        now = strtod(first, NULL);
      } else {
        fail(word, "no such call");
      }
    }
  }
  fprintf(stderr, "steps %ld seconds %.3f\n", steps, processor_seconds() - start);
}

int main(int count, char** words) {
  if (count != 6) fail("arguments", "expected FMI version, binary, resources, token and file of calls");
  version = atoi(words[1]);
  if (version != 2 && version != 3) fail(words[1], "expected 2 or 3");
  library = open_library(words[2]);
  if (!library) fail(words[2], "cannot be loaded");
  instantiate(words[4], words[3]);
  FILE* calls = fopen(words[5], "r");
  if (!calls) fail(words[5], "cannot be read");
  play(calls);
  if (version == 2) ((fmi2FreeInstanceTYPE*)entry("fmi2FreeInstance"))(instance);
  if (version == 3) ((fmi3FreeInstanceTYPE*)entry("fmi3FreeInstance"))(instance);
  return 0;
}
