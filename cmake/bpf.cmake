# SPDX-License-Identifier: Apache-2.0
# The BPF programs: built where clang-19, bpftool and libbpf are there, left out otherwise; XAuto then uses
# SCHED_FIFO and says so. No kernel is needed to build them. Sets XAUTO_HAVE_BPF, or XAUTO_NO_BPF_REASON.
option(XAUTO_BPF "Build the BPF programs (sched_ext, tracing) where the tools for it are installed" ON)

set(XAUTO_HAVE_BPF OFF)
set(XAUTO_NO_BPF_REASON "")
if(NOT XAUTO_BPF)
  set(XAUTO_NO_BPF_REASON "switched off with -DXAUTO_BPF=OFF")
else()
  find_program(XAUTO_BPF_CLANG NAMES clang-19)
  find_program(XAUTO_BPFTOOL NAMES bpftool PATHS /usr/sbin /sbin)
  find_package(PkgConfig QUIET)
  if(PKG_CONFIG_FOUND)
    # 1.4: the first whose skeletons know struct_ops members that a kernel lacks.
    pkg_check_modules(LIBBPF QUIET IMPORTED_TARGET libbpf>=1.4)
  endif()
  if(NOT XAUTO_BPF_CLANG)
    set(XAUTO_NO_BPF_REASON "clang-19 is not installed")
  elseif(NOT XAUTO_BPFTOOL)
    set(XAUTO_NO_BPF_REASON "bpftool is not installed")
  elseif(NOT TARGET PkgConfig::LIBBPF)
    set(XAUTO_NO_BPF_REASON "libbpf-dev 1.4 or later is not installed")
  else()
    set(XAUTO_HAVE_BPF ON)
    # Linked in where its archive is there (libbpf-dev has it): packages then install on a plain bookworm, whose libbpf is
    # too old. LGPL-2.1 or BSD-2-Clause.
    add_library(xauto_libbpf INTERFACE)
    find_library(XAUTO_LIBBPF_ARCHIVE NAMES libbpf.a)
    if(XAUTO_LIBBPF_ARCHIVE)
      target_include_directories(xauto_libbpf INTERFACE ${LIBBPF_INCLUDE_DIRS})
      target_link_libraries(xauto_libbpf INTERFACE ${XAUTO_LIBBPF_ARCHIVE} elf z)
    else()
      target_link_libraries(xauto_libbpf INTERFACE PkgConfig::LIBBPF)
    endif()
  endif()
endif()
if(XAUTO_HAVE_BPF)
  message(STATUS "BPF programs: built with ${XAUTO_BPF_CLANG} and ${XAUTO_BPFTOOL}")
else()
  message(STATUS "BPF programs: left out, ${XAUTO_NO_BPF_REASON}")
endif()

if(CMAKE_SYSTEM_PROCESSOR MATCHES "aarch64|arm64")
  set(XAUTO_BPF_ARCH arm64)
else()
  set(XAUTO_BPF_ARCH x86)
endif()

# xauto_bpf_skeleton(NAME): bpf/NAME.bpf.c -> NAME.bpf.o (no DWARF) and NAME.skel.h in the build folder.
function(xauto_bpf_skeleton name)
  set(source ${PROJECT_SOURCE_DIR}/bpf/${name}.bpf.c)
  set(out ${PROJECT_BINARY_DIR}/bpf)
  file(MAKE_DIRECTORY ${out})
  file(GLOB headers CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/bpf/*.bpf.h)
  # The last sed: bpftool 7.5 writes for a libbpf that is newer than Debian's; we attach struct_ops ourselves.
  add_custom_command(
    OUTPUT ${out}/${name}.bpf.o ${out}/${name}.skel.h
    COMMAND ${XAUTO_BPF_CLANG} -g -O2 -target bpf -mcpu=v3 -D__TARGET_ARCH_${XAUTO_BPF_ARCH} -Wall -Wextra -Werror
            -Wno-unused-parameter -fdebug-prefix-map=${PROJECT_SOURCE_DIR}=. -I${PROJECT_SOURCE_DIR}/bpf -I${PROJECT_SOURCE_DIR}/include
            -c ${source} -o ${out}/${name}.full.o
    COMMAND ${XAUTO_BPFTOOL} gen object ${out}/${name}.bpf.o ${out}/${name}.full.o
    COMMAND ${XAUTO_BPFTOOL} gen skeleton ${out}/${name}.bpf.o name ${name} > ${out}/${name}.skel.h
    COMMAND sed -i "/map->link = /d" ${out}/${name}.skel.h
    DEPENDS ${source} ${headers} ${PROJECT_SOURCE_DIR}/include/uapi/xauto/bpf.h
            ${PROJECT_SOURCE_DIR}/include/uapi/xauto/rule.h
    COMMENT "BPF ${name}"
    VERBATIM)
endfunction()
