// Included first in files of others that open a window for an error and wait: the text goes to stderr.
#pragma once

#include <windows.h>

#include <cstdio>

#undef MessageBox
#define MessageBox(window, text, title, kind) std::fprintf(stderr, "%s: %s\n", title, text)
