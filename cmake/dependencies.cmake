# SPDX-License-Identifier: Apache-2.0
# Everything that we link, each once. Why each is here: docs/dependencies.md. Installed by
# scripts/setup.sh. Foreign headers are SYSTEM so that our warning level stops at our own code.
option(XAUTO_LINK_IN "Link in every library but those of the compiler and of libc" OFF) # for systems that lack ours: docs/packages.md
if(XAUTO_LINK_IN)
  set(CMAKE_FIND_LIBRARY_SUFFIXES .a)
endif()
find_package(Threads REQUIRED)
find_package(nlohmann_json 3.9 REQUIRED)   # JSON: lib/model, see json_value.h there
find_package(CLI11 2.1 REQUIRED)           # command lines: tools/cli only
find_package(fmt 7.1 REQUIRED)             # text formatting
find_package(spdlog 1.8 REQUIRED)          # logs for people: lib/base/log.cc only
if(XAUTO_LINK_IN) # Debian has no archives of these two
  set(XAUTO_FMT fmt::fmt-header-only)
  set(XAUTO_SPDLOG spdlog::spdlog_header_only)
  set_target_properties(spdlog::spdlog_header_only PROPERTIES INTERFACE_LINK_LIBRARIES "Threads::Threads;fmt::fmt-header-only")
else()
  set(XAUTO_FMT fmt::fmt)
  set(XAUTO_SPDLOG spdlog::spdlog)
endif()
find_package(SQLite3 REQUIRED)             # recorded inputs: lib/record only
find_package(ZLIB REQUIRED)                # ... MCAP's checksums
find_package(Eigen3 3.3 REQUIRED NO_MODULE)  # dense linear algebra: solver only
find_path(XAUTO_EXPECTED_INCLUDE tl/expected.hpp REQUIRED)  # Result<T>
find_path(LPSOLVE_INCLUDE lpsolve/lp_lib.h REQUIRED)        # the ILP: solver/ only
find_library(LPSOLVE_LIBRARY NAMES lpsolve55_pic lpsolve55 REQUIRED)
find_library(COLAMD_LIBRARY NAMES colamd REQUIRED)
if(XAUTO_LINK_IN)
  find_library(SUITESPARSE_LIBRARY NAMES suitesparseconfig REQUIRED)
endif()
add_library(lpsolve INTERFACE)
target_include_directories(lpsolve SYSTEM INTERFACE ${LPSOLVE_INCLUDE})
target_link_libraries(lpsolve INTERFACE ${LPSOLVE_LIBRARY} ${COLAMD_LIBRARY} ${SUITESPARSE_LIBRARY} m dl)

# Netlink to xauto.ko; what is compressed in MCAP.
find_package(PkgConfig REQUIRED)
pkg_check_modules(LIBNL REQUIRED IMPORTED_TARGET libnl-genl-3.0)
pkg_check_modules(LZ4 REQUIRED IMPORTED_TARGET liblz4)
pkg_check_modules(ZSTD REQUIRED IMPORTED_TARGET libzstd)

# Traces in Perfetto's format: lib/story only.
find_package(Protobuf 3.12 REQUIRED)

# Topics to and from DDS: lib/transport/cyclonedds only, a plug-in.
option(XAUTO_CYCLONEDDS "Build the plug-in for Cyclone DDS (ROS 2) where cyclonedds-dev is installed" ON)
set(XAUTO_HAVE_CYCLONEDDS OFF)
if(XAUTO_CYCLONEDDS)
  find_package(CycloneDDS QUIET)
  if(CycloneDDS_FOUND)
    set(XAUTO_HAVE_CYCLONEDDS ON)
  endif()
endif()
message(STATUS "Plug-in for Cyclone DDS: ${XAUTO_HAVE_CYCLONEDDS}")

# What `xauto import` reads with others' libraries; without one it says so. libbabeltrace2 loads a plug-in of its own, so
# none of it is linked in.
pkg_check_modules(BABELTRACE2 QUIET IMPORTED_TARGET babeltrace2)
pkg_check_modules(LIBYAML QUIET IMPORTED_TARGET yaml-0.1)
find_package(EXPAT QUIET)
set(XAUTO_HAVE_EXPAT OFF)
if(EXPAT_FOUND AND NOT XAUTO_LINK_IN)
  set(XAUTO_HAVE_EXPAT ON)
endif()
set(XAUTO_HAVE_BABELTRACE OFF)
if(BABELTRACE2_FOUND AND NOT XAUTO_LINK_IN)
  set(XAUTO_HAVE_BABELTRACE ON)
endif()
set(XAUTO_HAVE_LIBYAML OFF)
if(LIBYAML_FOUND AND NOT XAUTO_LINK_IN)
  set(XAUTO_HAVE_LIBYAML ON)
endif()
message(STATUS "Import of LTTng traces: ${XAUTO_HAVE_BABELTRACE}, of architecture.yaml: ${XAUTO_HAVE_LIBYAML}, of Amalthea: ${XAUTO_HAVE_EXPAT}")
