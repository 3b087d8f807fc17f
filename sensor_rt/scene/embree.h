// Owning handles of Embree objects, and the calls whose signature differs between Embree 3 and 4.
#pragma once

#include <memory>
#include <type_traits>

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace sensor_rt {

struct SceneRelease {
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
};
struct GeometryRelease {
  void operator()(RTCGeometry geometry) const { rtcReleaseGeometry(geometry); }
};
using SceneHandle = std::unique_ptr<std::remove_pointer_t<RTCScene>, SceneRelease>;
using GeometryHandle = std::unique_ptr<std::remove_pointer_t<RTCGeometry>, GeometryRelease>;

/// Returns the Embree device that all scenes of the process share. It builds on one thread: the tree, and
/// with it the choice between two equally near triangles, is then reproducible. Throws std::runtime_error
/// when Embree cannot be initialised.
RTCDevice shared_device();

/// Throws std::runtime_error or std::bad_alloc when an Embree call of this thread has failed since the last
/// check.
void check_device(const char* action);

/// Finds the closest hits of up to 16 coherent rays.
inline void intersect16(RTCScene scene, const int* valid, RTCRayHit16& rays) {
#if RTC_VERSION_MAJOR >= 4
  RTCIntersectArguments arguments;
  rtcInitIntersectArguments(&arguments);
  arguments.flags = RTC_RAY_QUERY_FLAG_COHERENT;
  rtcIntersect16(valid, scene, &rays, &arguments);
#else
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  rtcIntersect16(valid, scene, &context, &rays);
#endif
}

/// Sets tfar to -infinity for each occluded ray. `coherent`: the rays have similar origins and directions.
inline void occluded16(RTCScene scene, const int* valid, bool coherent, RTCRay16& rays) {
#if RTC_VERSION_MAJOR >= 4
  RTCOccludedArguments arguments;
  rtcInitOccludedArguments(&arguments);
  arguments.flags = coherent ? RTC_RAY_QUERY_FLAG_COHERENT : RTC_RAY_QUERY_FLAG_INCOHERENT;
  rtcOccluded16(valid, scene, &rays, &arguments);
#else
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
  rtcOccluded16(valid, scene, &context, &rays);
#endif
}

}  // namespace sensor_rt
