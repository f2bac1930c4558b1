# find_package(pinograsp-core CONFIG REQUIRED) gives the target pinograsp::core: headers only, C++17.
if(NOT TARGET pinograsp::core)
  add_library(pinograsp::core INTERFACE IMPORTED)
  get_filename_component(pinograsp-core_INCLUDE_DIR "${CMAKE_CURRENT_LIST_DIR}/../include" ABSOLUTE)
  set_target_properties(pinograsp::core PROPERTIES
    INTERFACE_INCLUDE_DIRECTORIES "${pinograsp-core_INCLUDE_DIR}"
    INTERFACE_COMPILE_FEATURES cxx_std_17)
endif()
