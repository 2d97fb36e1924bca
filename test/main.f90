!> Every unit and verification test. One line per suite; `fpm @check -- contact` filters.
program main
  use test_adaptive, only: run_test_adaptive
  use test_cable_contact, only: run_test_cable_contact
  use test_capture_measures, only: run_test_capture_measures
  use test_checkpoint, only: run_test_checkpoint
  use test_command_line, only: run_test_command_line
  use test_contact, only: run_test_contact
  use test_compliant_contact, only: run_test_compliant_contact
  use test_convex_hull, only: run_test_convex_hull
  use test_deployment, only: run_test_deployment
  use test_diagnostics, only: run_test_diagnostics
  use test_fast_nodes, only: run_test_fast_nodes
  use test_friction, only: run_test_friction
  use test_log, only: run_test_log
  use test_mesh, only: run_test_mesh
  use test_monitors, only: run_test_monitors
  use test_net_builder, only: run_test_net_builder
  use test_net_file, only: run_test_net_file
  use test_output_files, only: run_test_output_files
  use test_perturb, only: run_test_perturb
  use test_lattice, only: run_test_lattice
  use test_renumber, only: run_test_renumber
  use test_rng, only: run_test_rng
  use test_rotation, only: run_test_rotation
  use test_run_writer, only: run_test_run_writer
  use test_scene_file, only: run_test_scene_file
  use test_segment, only: run_test_segment
  use test_self_contact, only: run_test_self_contact
  use test_setup, only: run_test_setup
  use test_shape, only: run_test_shape
  use test_stable_step, only: run_test_stable_step
  use test_study, only: run_test_study
  use test_study_file, only: run_test_study_file
  use test_text, only: run_test_text
  use test_threads, only: run_test_threads
  use verify_state_hash, only: run_verify_state_hash
  use testing, only: finish
  use verify_catenary, only: run_verify_catenary
  use verify_chain, only: run_verify_chain
  use verify_closing, only: run_verify_closing
  use verify_thread_flow, only: run_verify_thread_flow
  use verify_contact, only: run_verify_contact
  use verify_environment, only: run_verify_environment
  use verify_free_shot, only: run_verify_free_shot
  use verify_hard_cases, only: run_verify_hard_cases
  use verify_pulled_cable, only: run_verify_pulled_cable
  use verify_snap, only: run_verify_snap
  use verify_torque_free, only: run_verify_torque_free
  implicit none
  call run_test_adaptive()
  call run_test_cable_contact()
  call run_test_capture_measures()
  call run_test_checkpoint()
  call run_test_command_line()
  call run_test_contact()
  call run_test_compliant_contact()
  call run_test_convex_hull()
  call run_test_deployment()
  call run_test_diagnostics()
  call run_test_fast_nodes()
  call run_test_friction()
  call run_test_log()
  call run_test_mesh()
  call run_test_monitors()
  call run_test_net_builder()
  call run_test_net_file()
  call run_test_output_files()
  call run_test_perturb()
  call run_test_lattice()
  call run_test_renumber()
  call run_test_rng()
  call run_test_rotation()
  call run_test_run_writer()
  call run_test_scene_file()
  call run_test_segment()
  call run_test_self_contact()
  call run_test_setup()
  call run_test_shape()
  call run_test_stable_step()
  call run_test_study()
  call run_test_study_file()
  call run_test_text()
  call run_test_threads()
  call run_verify_catenary()
  call run_verify_chain()
  call run_verify_closing()
  call run_verify_thread_flow()
  call run_verify_contact()
  call run_verify_environment()
  call run_verify_free_shot()
  call run_verify_hard_cases()
  call run_verify_pulled_cable()
  call run_verify_snap()
  call run_verify_torque_free()
  call run_verify_state_hash()
  call finish()
end program main
