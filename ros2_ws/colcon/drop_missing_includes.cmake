# Given to every package as CMAKE_PROJECT_INCLUDE when ROS 2 comes from wheels.
#
# The CMake targets that the wheels export name include folders of the machine that built the wheels
# (/opt/python/...), and CMake refuses include folders that do not exist. When a directory has been read, drop these
# entries from the targets imported into it; nothing in the wheels is changed.

function(quadftc_drop_missing_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(includes "${target}" INTERFACE_INCLUDE_DIRECTORIES)
    if(includes)
      list(FILTER includes EXCLUDE REGEX "^/opt/python/")
      set_target_properties("${target}" PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${includes}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL quadftc_drop_missing_includes)
