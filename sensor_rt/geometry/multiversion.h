// Function multiversioning: hot loops are compiled for several vector widths, and the loader picks the widest
// that the CPU supports.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
/// Compiles a function for the x86-64 levels 1, 3 (AVX2) and 4 (AVX-512). Expands to nothing under
/// sanitizers, which cannot run the ifunc resolvers.
#define SENSOR_RT_MULTIVERSION __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define SENSOR_RT_MULTIVERSION
#endif
