# SPDX-License-Identifier: Apache-2.0
# ONNX Runtime, for the tests of xauto/onnx.h and examples/perception: the system's, or what scripts/fetch-onnx.sh has fetched.
# Target onnxruntime, where both header and library are there. No library or tool of XAuto's uses it.
find_path(ONNXRUNTIME_INCLUDE onnxruntime_c_api.h PATH_SUFFIXES onnxruntime HINTS ${PROJECT_SOURCE_DIR}/build/onnx/include)
find_library(ONNXRUNTIME_LIBRARY NAMES onnxruntime libonnxruntime.so.1 HINTS ${PROJECT_SOURCE_DIR}/build/onnx/lib)
mark_as_advanced(ONNXRUNTIME_INCLUDE ONNXRUNTIME_LIBRARY)
if(ONNXRUNTIME_INCLUDE AND ONNXRUNTIME_LIBRARY)
  add_library(onnxruntime INTERFACE)
  target_include_directories(onnxruntime SYSTEM INTERFACE ${ONNXRUNTIME_INCLUDE})
  target_link_libraries(onnxruntime INTERFACE ${ONNXRUNTIME_LIBRARY})
else()
  message(STATUS "tests of xauto/onnx.h and examples/perception are left out: ONNX Runtime is missing (scripts/fetch-onnx.sh)")
endif()
