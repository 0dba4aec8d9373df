function check_until(f, what)
%CHECK_UNTIL  Wait until f() holds, at most a minute.

    start = tic;
    while ~f()
        check(toc(start) < 60.0, 'not within a minute: %s', what);
        pause(0.01);
    end
end
