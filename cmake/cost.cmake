# SPDX-License-Identifier: Apache-2.0
# What compiling costs. A third of it was reading the same headers of the standard library for each file.
#   xauto_headers(TARGET)   they are compiled once for all such targets (precompiled; the preset `debug` does without)
#   xauto_cold(TARGET)      ... and Release has -Og: for what runs once, or waits for a person, a file, another process
# XAUTO_QUICK: all of it is. `make demo` on a bare machine waits for the compiler more than for the solver.
set(XAUTO_HEADERS ${CMAKE_CURRENT_LIST_DIR}/headers.h)
set(XAUTO_COLD $<$<CONFIG:Release>:-Og>)
option(XAUTO_QUICK "compile in little time what then runs slower" OFF)
if(XAUTO_QUICK)
  add_compile_options(${XAUTO_COLD})
endif()
# Garbage collection was a seventh of what GCC took for the solver. Without it, that one takes 1.9 GB instead of 1.2.
cmake_host_system_information(RESULT ram_mb QUERY TOTAL_PHYSICAL_MEMORY)
if(ram_mb GREATER 7000)
  add_compile_options($<$<COMPILE_LANG_AND_ID:CXX,GNU>:--param=ggc-min-heapsize=1000000>) # KB
endif()
# With its time in it Clang's file would be another one each time, and ccache would find nothing that was compiled with it.
add_compile_options("$<$<COMPILE_LANG_AND_ID:CXX,Clang>:SHELL:-Xclang -fno-pch-timestamp>")
if(NOT EXISTS ${PROJECT_BINARY_DIR}/headers.cc)
  file(WRITE ${PROJECT_BINARY_DIR}/headers.cc "") # CMake wants a file
endif()
# One for both: GCC takes it at another -O than it was made at, as long as that is not -O0.
add_library(xauto_precompiled OBJECT EXCLUDE_FROM_ALL ${PROJECT_BINARY_DIR}/headers.cc)
target_link_libraries(xauto_precompiled PRIVATE ${XAUTO_FMT})
target_precompile_headers(xauto_precompiled PRIVATE ${XAUTO_HEADERS})

function(xauto_headers target)
  cmake_parse_arguments(ARG "" "FROM" "" ${ARGN})
  if(NOT ARG_FROM)
    set(ARG_FROM xauto_precompiled)
  endif()
  target_link_libraries(${target} PRIVATE ${XAUTO_FMT}) # the headers were compiled with its definitions
  target_precompile_headers(${target} REUSE_FROM ${ARG_FROM})
  get_target_property(type ${target} TYPE)
  if(type STREQUAL "EXECUTABLE")
    target_compile_options(${target} PRIVATE -fPIC) # as the headers were; CMake's -fPIE would be another option
  endif()
endfunction()
function(xauto_cold target)
  target_compile_options(${target} PRIVATE ${XAUTO_COLD})
  xauto_headers(${target})
endfunction()
