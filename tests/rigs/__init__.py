"""What tests share: peers and clients written by hand, rigs around a device, tables of what to send.

* The core: `scripted_engine`, `scripted_arm`, `judged_arm`.
* Any device: `bad_inputs`, `extreme_values`, `claimed_values`; `plugin_install`.
* A driver at its simulator: `ur_bench`, `canopen_arm`, `dynamixel_bench`, `netft_bench`.
* A driver at a far side of which the test chooses each byte: `ur_proxy`, `canopen_peer`, `dynamixel_peer`,
  `dynamixel_packets`, `netft_peer`.
* A simulator without a driver: `ur_clients`, `ur_controller`, `ur_interpreter`, `ur_fuzz_corpus`,
  `urscript_runtime`, `canopen_drive`, `can_hub_doors`, `dynamixel_clients`, `netft_clients`.
* ROS 2: `loopback_node`, `loopback_client`, `ur_node`, `ros_client`.
* Programs that tests start: `serve_loopback`, `stream_positions`; `ur_rtde_sessions` and `ur_rtde_motions`,
  by `ur_rtde_runs`. How they are started: `programs`, `warm_start`.
"""
