# Read only when scikit-build-core makes a wheel (pip, uv); colcon never sees it.

# The ros-* wheels lay one ROS prefix over a Python environment. Ask Python which one: under
# build isolation it is the environment of the build, not the one that the wheel is for.
find_package(Python3 REQUIRED COMPONENTS Interpreter)
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
    "import ament_index_python as a, pathlib; print(pathlib.Path(a.__file__).resolve().parents[4])"
  OUTPUT_VARIABLE ros_prefix OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
list(PREPEND CMAKE_PREFIX_PATH "${ros_prefix}")
set(ENV{AMENT_PREFIX_PATH} "${ros_prefix}")

# Their CMake targets name include directories of the machine that built them, which CMake refuses.
# Drop those that do not exist, once every find_package has run.
function(drop_missing_include_directories)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    set(kept "")
    foreach(directory IN LISTS directories)
      if(directory MATCHES "^\\$<" OR IS_DIRECTORY "${directory}")
        list(APPEND kept "${directory}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
  endforeach()
endfunction()
cmake_language(DEFER CALL drop_missing_include_directories)

# Python needs the C type support only: a third of the build time of C and C++ together. Fast DDS needs that of
# introspection too, to tell others of the types. Call it between find_package and rosidl_generate_interfaces.
macro(skip_cpp_generators)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "_cpp:")
endmacro()

# Each generated source includes the same headers, which takes longer to read than the rest to compile: one
# translation unit a library. Descriptions stay apart, since they share names. Call it after
# rosidl_generate_interfaces.
function(compile_at_once)
  get_property(targets DIRECTORY PROPERTY BUILDSYSTEM_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(type ${target} TYPE)
    if(type MATCHES "^(SHARED|STATIC|MODULE)_LIBRARY$")
      set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 0)
      get_target_property(sources ${target} SOURCES)
      list(FILTER sources INCLUDE REGEX "__description\\.c$")
      set_source_files_properties(${sources} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
    endif()
  endforeach()
endfunction()
