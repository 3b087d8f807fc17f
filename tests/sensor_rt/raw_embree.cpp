// Times bare Embree on the rays of profiles: `sensor-raw-embree FILE REPEATS`. Single precision, packets, one
// thread; the mesh is built as the sensor builds it. FILE (tests/bench/raw_embree.py writes it): the numbers
// of vertices, faces, fans, rays per fan and viewpoints; the mesh; of each fan its source, its viewpoints and
// its directions.
#include <time.h>

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <vector>

#include "sensor_rt/scene/mesh_shape.h"

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

template <int width>
struct Packet;
template <>
struct Packet<8> {
  using RayHit = RTCRayHit8;
  using Ray = RTCRay8;
  static constexpr auto intersect = &rtcIntersect8;
  static constexpr auto occluded = &rtcOccluded8;
};
template <>
struct Packet<16> {
  using RayHit = RTCRayHit16;
  using Ray = RTCRay16;
  static constexpr auto intersect = &rtcIntersect16;
  static constexpr auto occluded = &rtcOccluded16;
};

/// The calls differ between Embree 3 and 4.
#if RTC_VERSION_MAJOR >= 4
template <int width>
void intersect(RTCScene scene, const int* valid, typename Packet<width>::RayHit& rays) {
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
  Packet<width>::intersect(valid, scene, &rays, &arguments);
}
template <int width>
void occluded(RTCScene scene, const int* valid, typename Packet<width>::Ray& rays) {
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
  Packet<width>::occluded(valid, scene, &rays, &arguments);
}
#else
RTCIntersectContext coherent() {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  return context;
}
template <int width>
void intersect(RTCScene scene, const int* valid, typename Packet<width>::RayHit& rays) {
  RTCIntersectContext context = coherent();
  Packet<width>::intersect(valid, scene, &context, &rays);
}
template <int width>
void occluded(RTCScene scene, const int* valid, typename Packet<width>::Ray& rays) {
  RTCIntersectContext context = coherent();
  Packet<width>::occluded(valid, scene, &context, &rays);
}
#endif

struct Input {
  std::uint64_t vertices, faces, fans, rays, viewpoints;
  std::vector<double> vertex;
  std::vector<std::uint32_t> face;
  std::vector<float> source;     ///< (fans, 3)
  std::vector<float> viewpoint;  ///< (fans, viewpoints, 3)
  std::vector<float> direction;  ///< (fans, rays, 3)
};

template <typename T>
std::vector<T> read(std::ifstream& file, std::uint64_t count) {
  std::vector<T> values(count);
  file.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(count * sizeof(T)));
  if (!file) throw std::runtime_error("the file is too short");
  return values;
}

Input read_input(const char* path) {
  std::ifstream file(path, std::ios::binary);
  const std::vector<std::uint64_t> n = read<std::uint64_t>(file, 5);
  Input input{n[0], n[1], n[2], n[3], n[4], {}, {}, {}, {}, {}};
  input.vertex = read<double>(file, 3 * n[0]);
  input.face = read<std::uint32_t>(file, 3 * n[1]);
  input.source = read<float>(file, 3 * n[2]);
  input.viewpoint = read<float>(file, 3 * n[2] * n[4]);
  input.direction = read<float>(file, 3 * n[2] * n[3]);
  return input;
}

/// Into the frame of the scene.
void shift(const Eigen::Vector3d& centre, std::vector<float>& points) {
  for (std::size_t i = 0; i < points.size(); ++i)
    points[i] -= static_cast<float>(centre[static_cast<Eigen::Index>(i % 3)]);
}

template <typename Ray>
void set_ray(Ray& rays, int l, const float* origin, const float* direction, float farthest) {
  rays.org_x[l] = origin[0];
  rays.org_y[l] = origin[1];
  rays.org_z[l] = origin[2];
  rays.dir_x[l] = direction[0];
  rays.dir_y[l] = direction[1];
  rays.dir_z[l] = direction[2];
  rays.tnear[l] = 0.0f;
  rays.tfar[l] = farthest;
  rays.time[l] = 0.0f;
  rays.mask[l] = ~0u;
  rays.id[l] = 0;
  rays.flags[l] = 0;
}

/// Distances of the closest hits, and their faces.
template <int width>
void cast(RTCScene scene, const Input& input, std::vector<float>& t, std::vector<unsigned>& face) {
  alignas(64) int valid[width];
  std::fill(valid, valid + width, -1);
  for (std::size_t fan = 0; fan < input.fans; ++fan) {
    for (std::size_t first = fan * input.rays; first < (fan + 1) * input.rays; first += width) {
      typename Packet<width>::RayHit rays;
      for (int l = 0; l < width; ++l) {
        set_ray(rays.ray, l, &input.source[3 * fan],
                &input.direction[3 * (first + static_cast<std::size_t>(l))], kInfinity);
        rays.hit.geomID[l] = RTC_INVALID_GEOMETRY_ID;
      }
      intersect<width>(scene, valid, rays);
      for (int l = 0; l < width; ++l) {
        t[first + static_cast<std::size_t>(l)] =
            rays.hit.geomID[l] == RTC_INVALID_GEOMETRY_ID ? kInfinity : rays.ray.tfar[l];
        face[first + static_cast<std::size_t>(l)] = rays.hit.primID[l];
      }
    }
  }
}

/// Casts rays from every viewpoint to the laser hits; returns the number of occluded ones.
template <int width>
long count_occluded(RTCScene scene, const Input& input, const std::vector<float>& t) {
  long cut = 0;
  for (std::size_t fan = 0; fan < input.fans; ++fan) {
    const float* source = &input.source[3 * fan];
    for (std::size_t e = 0; e < input.viewpoints; ++e) {
      const float* viewpoint = &input.viewpoint[3 * (fan * input.viewpoints + e)];
      for (std::size_t first = fan * input.rays; first < (fan + 1) * input.rays; first += width) {
        alignas(64) int valid[width];
        typename Packet<width>::Ray rays;
        for (int l = 0; l < width; ++l) {
          const std::size_t ray = first + static_cast<std::size_t>(l);
          const float distance = t[ray] < kInfinity ? t[ray] : 1.0f;
          float direction[3];
          for (int k = 0; k < 3; ++k)
            direction[k] =
                source[k] + distance * input.direction[3 * ray + static_cast<std::size_t>(k)] - viewpoint[k];
          valid[l] = t[ray] < kInfinity ? -1 : 0;
          set_ray(rays, l, viewpoint, direction, 0.9999f);
        }
        occluded<width>(scene, valid, rays);
        for (int l = 0; l < width; ++l) cut += valid[l] != 0 && rays.tfar[l] < 0.0f;
      }
    }
  }
  return cut;
}

double seconds(clockid_t clock) {
  timespec now;
  clock_gettime(clock, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

struct Seconds {
  double wall = std::numeric_limits<double>::infinity();
  double processor = std::numeric_limits<double>::infinity();
};

/// The best of the repeats, after one that is not counted.
template <typename Work>
Seconds measure(int repeats, const Work& work) {
  Seconds best;
  for (int i = 0; i <= repeats; ++i) {
    const double wall = seconds(CLOCK_MONOTONIC);
    const double processor = seconds(CLOCK_PROCESS_CPUTIME_ID);
    work();
    if (i == 0) continue;
    best.wall = std::min(best.wall, seconds(CLOCK_MONOTONIC) - wall);
    best.processor = std::min(best.processor, seconds(CLOCK_PROCESS_CPUTIME_ID) - processor);
  }
  return best;
}

template <int width>
void run(RTCScene scene, const Input& input, int repeats) {
  std::vector<float> t(input.fans * input.rays);
  std::vector<unsigned> face(t.size());
  long cut = 0;
  const Seconds laser = measure(repeats, [&] { cast<width>(scene, input, t, face); });
  const Seconds views = measure(repeats, [&] { cut = count_occluded<width>(scene, input, t); });
  const long hits = std::count_if(t.begin(), t.end(), [](float one) { return one < kInfinity; });
  std::printf(
      "{\"width\": %d, \"laser\": [%.9g, %.9g], \"views\": [%.9g, %.9g], \"hits\": %ld, \"cut\": %ld}\n",
      width, laser.wall, laser.processor, views.wall, views.processor, hits, cut);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: sensor-raw-embree FILE REPEATS\n");
    return 2;
  }
  try {
    Input input = read_input(argv[1]);
    if (input.rays % 16 != 0) throw std::runtime_error("the rays of a fan do not fill packets of 16");
    const sensor_rt::MeshView mesh{input.vertex.data(), input.vertices, input.face.data(), input.faces};
    const Eigen::Vector3d centre = sensor_rt::mesh_centre(mesh);
    const sensor_rt::SceneHandle scene = sensor_rt::build_triangle_scene(mesh, centre);
    shift(centre, input.source);
    shift(centre, input.viewpoint);
    run<8>(scene.get(), input, std::atoi(argv[2]));
    run<16>(scene.get(), input, std::atoi(argv[2]));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sensor-raw-embree: %s: %s\n", argv[1], error.what());
    return 1;
  }
  return 0;
}
