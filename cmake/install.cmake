# SPDX-License-Identifier: Apache-2.0
# What `cmake --install` puts where, by component: runtime (libxauto.so.1), development (headers, CMake package, pkg-config), tools.
# debian/ makes packages of the same; docs/packages.md says what is in which.
if(XAUTO_SANITIZE)
  return() # not for users
endif()
include(CMakePackageConfigHelpers)

# The shared library: what implements include/xauto/, and of the rest only what this needs (--gc-sections). The tools use more of
# the archives than the API offers, so they stay linked statically. The tools make the run's BPF maps, apps open them: no libbpf here.
set(XAUTO_SOVERSION 1)
set(map ${PROJECT_SOURCE_DIR}/packaging/libxauto.map)
set(no_libbpf lib/kernel/without_libbpf/none.cc)
add_library(xauto_shared SHARED ${no_libbpf})
foreach(api xauto_app xauto_graph xauto_model xauto_xpu xauto_emu) # what the headers declare; the rest comes as they need it
  target_sources(xauto_shared PRIVATE $<TARGET_OBJECTS:${api}>)
endforeach()
set_source_files_properties(${no_libbpf} PROPERTIES COMPILE_DEFINITIONS XAUTO_NO_BPF_REASON="the xauto tool loads them")
target_link_libraries(xauto_shared PRIVATE xauto_app)
target_link_options(xauto_shared PRIVATE -Wl,--version-script=${map} -Wl,--no-undefined -Wl,--as-needed -Wl,--gc-sections
                                         -Wl,-z,relro -Wl,-z,now)
target_include_directories(xauto_shared INTERFACE $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>)
target_compile_features(xauto_shared INTERFACE cxx_std_20)
set_target_properties(xauto_shared PROPERTIES OUTPUT_NAME xauto EXPORT_NAME xauto VERSION ${PROJECT_VERSION}
                                              SOVERSION ${XAUTO_SOVERSION} LINK_DEPENDS ${map}
                                              LIBRARY_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/lib)
install(TARGETS xauto_shared EXPORT xauto-targets
        LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT runtime NAMELINK_COMPONENT development)

# A plug-in, found beside it; no Debian package has it.
if(TARGET xauto_cyclonedds)
  install(TARGETS xauto_cyclonedds LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR}/xauto COMPONENT interop)
endif()

# Development: find_package(xauto), pkg-config, headers; and the one header of somebody else's that ours include.
if(XAUTO_LINK_IN)
  set(XAUTO_BUNDLED ${CMAKE_INSTALL_INCLUDEDIR}/xauto/bundled)
  set(XAUTO_PC_BUNDLED " -isystem \${prefix}/${XAUTO_BUNDLED}")
  target_include_directories(xauto_shared SYSTEM INTERFACE $<INSTALL_INTERFACE:${XAUTO_BUNDLED}>)
  install(FILES ${XAUTO_EXPECTED_INCLUDE}/tl/expected.hpp DESTINATION ${XAUTO_BUNDLED}/tl COMPONENT development)
endif()
set(cmake_dir ${CMAKE_INSTALL_LIBDIR}/cmake/xauto)
install(EXPORT xauto-targets NAMESPACE xauto:: DESTINATION ${cmake_dir} COMPONENT development)
configure_package_config_file(packaging/xauto-config.cmake.in ${PROJECT_BINARY_DIR}/package/xauto-config.cmake
                              INSTALL_DESTINATION ${cmake_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/package/xauto-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/package/xauto-config.cmake ${PROJECT_BINARY_DIR}/package/xauto-config-version.cmake
        DESTINATION ${cmake_dir} COMPONENT development)
# xauto_add_messages, and what it runs.
install(FILES cmake/messages.cmake DESTINATION ${cmake_dir} COMPONENT development)
install(DIRECTORY tools/messages DESTINATION ${cmake_dir} COMPONENT development FILES_MATCHING PATTERN "*.py" PATTERN "*.msg")
string(REGEX REPLACE "[^/]+" ".." XAUTO_PC_UP ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
configure_file(packaging/xauto.pc.in ${PROJECT_BINARY_DIR}/package/xauto.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/package/xauto.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig COMPONENT development)
install(DIRECTORY include/xauto DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT development FILES_MATCHING PATTERN "*.h")

# Tools: xauto looks for the daemons beside itself, behind symbolic links, so only the link is in the PATH.
set(tools xauto xauto-coordinator xauto-emud xauto-cpusched xauto-system xauto-standin)
foreach(tool ${tools})
  target_link_options(${tool} PRIVATE -Wl,-z,relro -Wl,-z,now)
endforeach()
install(TARGETS xauto_watch LIBRARY DESTINATION ${CMAKE_INSTALL_LIBEXECDIR}/xauto COMPONENT tools
        PERMISSIONS OWNER_READ OWNER_WRITE GROUP_READ WORLD_READ)
install(TARGETS ${tools} RUNTIME DESTINATION ${CMAKE_INSTALL_LIBEXECDIR}/xauto COMPONENT tools)
file(CREATE_LINK ../${CMAKE_INSTALL_LIBEXECDIR}/xauto/xauto ${PROJECT_BINARY_DIR}/package/xauto SYMBOLIC)
install(FILES ${PROJECT_BINARY_DIR}/package/xauto DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT tools)

# Man pages and bash's completion, from what the tool says with --help; of a cross-build the tool cannot be asked.
set(XAUTO_HOST_HELP "" CACHE PATH "what packaging/from-help.py wrote for a build of this machine, for a cross-build")
set(help ${PROJECT_BINARY_DIR}/package/help)
if(XAUTO_HOST_HELP)
  set(help ${XAUTO_HOST_HELP})
  add_custom_target(xauto_help)
else()
  find_package(Python3 REQUIRED COMPONENTS Interpreter)
  add_custom_command(OUTPUT ${help}/completions/xauto
                     COMMAND ${Python3_EXECUTABLE} ${PROJECT_SOURCE_DIR}/packaging/from-help.py $<TARGET_FILE_DIR:xauto> ${help}
                     DEPENDS xauto packaging/from-help.py VERBATIM)
  add_custom_target(xauto_help ALL DEPENDS ${help}/completions/xauto)
endif()
install(DIRECTORY ${help}/man1 DESTINATION ${CMAKE_INSTALL_MANDIR} COMPONENT tools)
install(FILES ${help}/completions/xauto DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions COMPONENT tools)

# Python's, where Debian's finds it.
install(DIRECTORY tools/python/xauto DESTINATION lib/python3/dist-packages COMPONENT python FILES_MATCHING PATTERN "*.py")
install(DIRECTORY tools/python/notebooks DESTINATION ${CMAKE_INSTALL_DOCDIR}/examples COMPONENT examples FILES_MATCHING PATTERN "*.ipynb")

# The Debian packages take their own.
install(DIRECTORY examples/template examples/camera DESTINATION ${CMAKE_INSTALL_DOCDIR}/examples COMPONENT examples)
install(FILES packaging/examples/camera.conf packaging/examples/limits.conf packaging/grafana/xauto.json
        DESTINATION ${CMAKE_INSTALL_DOCDIR}/examples COMPONENT examples)

# For editors and other programs.
install(DIRECTORY docs/schema/ DESTINATION ${CMAKE_INSTALL_DATADIR}/xauto/schema COMPONENT tools FILES_MATCHING PATTERN "*.schema.json")
