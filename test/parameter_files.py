"""Parameter files that tests of `read_file` and of the nodes share."""

SECTIONS = """
ins_node:
  ros__parameters:
    alignment.duration: 30.0
    alignment.max_speed: 4.0
/**:
  ros__parameters:
    alignment:
      duration: 10.0
    imu: {sampling: instantaneous, mounting_rpy_deg: [180, 0, 0]}
/robot/ins_node:
  ros__parameters:
    initial.heading_deg: 5.0
/*/ins_node:
  ros__parameters:
    initial.heading_stddev_deg: 6.0
/robot/**:
  ros__parameters:
    imu.max_gap: 7.0
ship:
  ins_node:
    ros__parameters:
      imu.max_gap: 8.0
/**/ins_node:
  ros__parameters:
    zupt.max_rocking_deg: 9.0
other_node:
  ros__parameters:
    anything: 1
"""
"""Every kind of section; the order matters."""

DUMP = """
/robot/ins_node:
  ros__parameters:
    alignment:
      duration: 30.0
    initial:
      heading_deg: .nan
    qos_overrides:
      /parameter_events:
        publisher:
          depth: 1000
          durability: volatile
    start_type_description_service: true
    state_file: ''
    use_sim_time: false
"""
"""As `ros2 param dump` writes it."""
