"""The CMake project of an export in C."""

from capsyn.exports.plan import Plan


def cmake(plan: Plan, prefix: str) -> str:
    """Return the text of ``CMakeLists.txt``."""
    about = "\n".join(f"# {line}" for line in plan.header)
    return f"""{about}
cmake_minimum_required(VERSION 3.10)
project({prefix} C)
add_library({prefix} STATIC {prefix}.c)
set_target_properties({prefix} PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON)
target_include_directories({prefix} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
# what a program does not use is left out by -Wl,--gc-sections
target_compile_options({prefix} PRIVATE -ffunction-sections -fdata-sections)
"""
