function check_until(f, what)
%CHECK_UNTIL  Wait until f() holds, at most 10 s.

    start = tic;
    while ~f()
        check(toc(start) < 10.0, 'not within 10 s: %s', what);
        pause(0.01);
    end
end
