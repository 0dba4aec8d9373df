function octave_feedback()
%OCTAVE_FEEDBACK  Shapes, types and values of what comes from the device.

    ral = crtk.ral('octave_feedback');
    r = device_under_test(getenv('CRTK_NAMESPACE'), ral, {'measured_js', 'measured_cp', ...
        'measured_cv', 'measured_cf', 'setpoint_js', 'setpoint_cp', 'goal_js', 'jacobian', ...
        'trajectory_j_ratio', 'trajectory_j_set_ratio', 'move_jp'});
    r.crtk_utils.add('local/measured_cp');
    ral.check_connections();

    % nothing came yet: a warning, and empty outputs
    lastwarn('', '');
    [jp, jv, jf, stamp] = r.goal_js('wait', 0.1);
    check(isempty(jp) && isempty(jv) && isempty(jf) && isempty(stamp), 'goal_js is not empty');
    [text, identifier] = lastwarn();
    check(strcmp(identifier, 'crtk:NoData'), 'identifier: %s', identifier);
    check(strcmp(text, sprintf('goal_js has not received messages yet (topic /%s/goal_js)', ...
        getenv('CRTK_NAMESPACE'))), 'text: %s', text);

    r.enable(60.0);
    goal = [0.1; -0.2; 0.3; pi / 4];
    check(r.move_jp(goal).wait(false, 60.0), 'the move did not end');
    check_until(@() norm(r.measured_js() - goal) < 1e-4, 'the device is at the goal');

    % joints are columns
    [jp, jv, jf, stamp] = r.measured_js();
    check_near(jp, goal, 1e-4, 'measured_js: position');
    check_near(jv, zeros(4, 1), 1e-2, 'measured_js: velocity');
    check_near(jf, zeros(4, 1), 20.0 * 1e-2, 'measured_js: effort'); % 20 N s/m times that velocity
    check(isa(stamp, 'double') && abs(stamp - ral.now()) < 5.0, 'stamp %.3f', stamp);
    [jp, stamp] = r.setpoint_jp();
    check_near(jp, goal, 1e-6, 'setpoint_jp');
    check(stamp > 1e9, 'stamp of a part: %g', stamp);
    check_near(r.measured_jv(), zeros(4, 1), 1e-2, 'measured_jv');
    check_near(r.goal_js(), goal, 0.0, 'goal_js, to the last digit');

    % poses are homogeneous matrices, twists and wrenches rows
    expected = [cos(pi / 4), -sin(pi / 4), 0, 0.1; sin(pi / 4), cos(pi / 4), 0, -0.2; ...
        0, 0, 1, 0.3; 0, 0, 0, 1];
    [cp, stamp] = r.measured_cp();
    check_near(cp, expected, 1e-3, 'measured_cp');
    check(stamp > 1e9, 'stamp of a pose: %g', stamp);
    check_near(r.setpoint_cp(), expected, 1e-6, 'setpoint_cp');
    check_near(r.local_measured_cp(), expected, 1e-3, 'local/measured_cp');
    check_near(r.measured_cv(), zeros(1, 6), 1e-2, 'measured_cv');
    check_near(r.measured_cf(), zeros(1, 6), 20.0 * 1e-2, 'measured_cf');
    jacobian = zeros(6, 4);
    jacobian([1, 8, 15, 24]) = 1.0;
    check_near(r.jacobian(), jacobian, 0.0, 'jacobian');
    r.trajectory_j_set_ratio(0.5);
    check_until(@() r.trajectory_j_ratio() == 0.5, 'the ratio is 0.5');
    check_near(r.trajectory_j_ratio(), 0.5, 0.0, 'a number');

    % age and wait
    [~, old] = r.measured_jp('age', 0);
    [~, new] = r.measured_jp('age', 0.05, 'wait', 2.0);
    check(new >= old, 'the newer one is older');
    check_raises('crtk:Input', 'measured_js: pass ''age''', @() r.measured_js('aeg', 1.0));
    check_raises('crtk:Input', 'measured_js: pass ''age''', @() r.measured_js('age'));
    ral.shutdown();
end
