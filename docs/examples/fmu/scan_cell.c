/* Imports the FMU of a cell (FMI 2): moves the arm over the part, turns the table under the sensor with an
   exposure every 0.1 rad, and writes the records of the exposures for `scancell render`.

   cc -std=c11 -Wall -Wextra -I fmu/third_party/fmi docs/examples/fmu/scan_cell.c -o scan_cell -ldl
   ./scan_cell folder_of_unpacked_fmu recording.csv */
#define _XOPEN_SOURCE 700
#include "fmi2FunctionTypes.h"

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ENTRY(name) name##TYPE* name = (name##TYPE*)entry(#name)

static const char kVariable[] = "<ScalarVariable name=\"", kReference[] = "\" valueReference=\"";
static const double kStep = 0.016;  // s: one cycle of the controller
static const double kAbovePart[] = {0.0, -1.0278, 3.5967,
                                    0.0, 0.5727,  0.5236};  // joints of the default cell, rad

static char description[4 << 20];  // text of modelDescription.xml
static void* library;
static fmi2Component cell;
static FILE* recording;
static double now;  // s
static int last_index;

static void fail(const char* what, const char* why) {
  fprintf(stderr, "scan_cell: %s: %s\n", what, why);
  exit(1);
}

static void check(fmi2Status status, const char* what) {
  if (status > fmi2Warning) fail(what, "the FMU reports an error");
}

static void log_message(void* environment, fmi2String instance, fmi2Status status, fmi2String category,
                        fmi2String format, ...) {
  va_list values;
  (void)environment, (void)status, (void)category;
  fprintf(stderr, "%s: ", instance);
  va_start(values, format);
  vfprintf(stderr, format, values);
  va_end(values);
  fputc('\n', stderr);
}

static void* entry(const char* name) {
  void* found = dlsym(library, name);
  if (!found) fail(name, "no such function in the FMU");
  return found;
}

// Reference of a variable, and the first letter of its type: Real, Integer, Enumeration, Boolean.
static fmi2ValueReference find(const char* name, char* type) {
  char text[200];
  const int length = snprintf(text, sizeof text, "%s%s%s", kVariable, name, kReference);
  const char* found = strstr(description, text);
  if (!found) fail(name, "no such variable in the FMU");
  *type = strstr(found, "\"><")[3];
  return (fmi2ValueReference)strtoul(found + length, NULL, 10);
}

static void set(const char* name, double value) {
  ENTRY(fmi2SetReal);
  ENTRY(fmi2SetInteger);
  char type;
  const fmi2ValueReference variable = find(name, &type);
  const fmi2Integer integer = (fmi2Integer)value;
  check(type == 'R' ? fmi2SetReal(cell, &variable, 1, &value) : fmi2SetInteger(cell, &variable, 1, &integer),
        name);
}

static double get(const char* name) {
  ENTRY(fmi2GetReal);
  ENTRY(fmi2GetInteger);
  ENTRY(fmi2GetBoolean);
  char type;
  const fmi2ValueReference variable = find(name, &type);
  double value;
  fmi2Integer integer;
  if (type == 'R') {
    check(fmi2GetReal(cell, &variable, 1, &value), name);
    return value;
  }
  check((type == 'B' ? fmi2GetBoolean : fmi2GetInteger)(cell, &variable, 1, &integer), name);
  return integer;
}

// Names of all variables of the trigger record, or their values.
static void write_row(int is_header) {
  const char *at = description, *separator = "";
  while ((at = strstr(at, kVariable))) {
    char name[100];
    at += strlen(kVariable);
    if (sscanf(at, "%99[^\"]", name) != 1 || strncmp(name, "trigger.", 8)) continue;
    if (is_header)
      fprintf(recording, "%s%s", separator, name);
    else
      fprintf(recording, "%s%.17g", separator, get(name));
    separator = ",";
  }
  fputc('\n', recording);
}

// After each step the FMU shows at most one new record.
static void step(void) {
  ENTRY(fmi2DoStep);
  check(fmi2DoStep(cell, now, kStep, fmi2True), "fmi2DoStep");
  now += kStep;
  if (get("controller.error") != 0) fail("controller.error", "the cell rejects the command");
  if ((int)get("trigger.index") == last_index) return;
  last_index = (int)get("trigger.index");
  write_row(0);
}

// Moves all axes to the commanded angles. Outputs show the command after two steps.
static void move(int number) {
  set("command.start", number);
  step();
  step();
  while (!get("controller.at_destination")) step();
}

static void scan(void) {
  for (int i = 0; i < 6; ++i) {
    char name[40];
    snprintf(name, sizeof name, "command.q[%d]", i + 1);
    set(name, kAbovePart[i]);
  }
  set("command.mode", 2);  // joint move
  set("command.speed", 0.5);
  move(1);
  set("command.speed", 0.25);
  set("command.table", 6.2832);
  set("command.trigger.mode", 2);  // by table angle
  set("command.trigger.angle", 0.1);
  set("command.exposure", 0.0005);
  set("command.segment", 1);
  move(2);
  set("command.trigger.mode", 0);
  while (last_index < (int)get("trigger.count")) step();
}

int main(int count, char** words) {
  char folder[4096], path[4200], guid[80];
  if (count != 3) fail("arguments", "expected the folder of the unpacked FMU and the file to write");
  if (!realpath(words[1], folder)) fail(words[1], "no such folder");
  snprintf(path, sizeof path, "%s/modelDescription.xml", folder);
  FILE* file = fopen(path, "r");
  if (!file || !fread(description, 1, sizeof description - 1, file)) fail(path, "cannot be read");
  fclose(file);
  const char* at = strstr(description, "guid=\"");
  if (!at || sscanf(at, "guid=\"%79[^\"]", guid) != 1) fail(path, "no guid");

  snprintf(path, sizeof path, "%s/binaries/linux64/RobotCell.so", folder);
  library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
  if (!library) fail(path, dlerror());
  ENTRY(fmi2Instantiate);
  ENTRY(fmi2SetupExperiment);
  ENTRY(fmi2EnterInitializationMode);
  ENTRY(fmi2ExitInitializationMode);
  ENTRY(fmi2FreeInstance);
  const fmi2CallbackFunctions callbacks = {log_message, calloc, free, NULL, NULL};
  snprintf(path, sizeof path, "file://%s/resources", folder);
  cell = fmi2Instantiate("cell", fmi2CoSimulation, guid, path, &callbacks, fmi2False, fmi2False);
  if (!cell) fail(path, "the FMU cannot be instantiated");
  check(fmi2SetupExperiment(cell, fmi2False, 0.0, 0.0, fmi2False, 0.0), "fmi2SetupExperiment");
  check(fmi2EnterInitializationMode(cell), "fmi2EnterInitializationMode");
  check(fmi2ExitInitializationMode(cell), "fmi2ExitInitializationMode");

  recording = fopen(words[2], "w");
  if (!recording) fail(words[2], "cannot be written");
  write_row(1);
  scan();
  if (fclose(recording)) fail(words[2], "cannot be written");
  fmi2FreeInstance(cell);
  return 0;
}
