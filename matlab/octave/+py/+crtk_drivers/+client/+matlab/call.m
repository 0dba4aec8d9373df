function answer = call(request, executable)
%CALL  For GNU Octave, which cannot call Python: the same text, over a pipe to the same process.

    persistent input output process
    if isempty(process)
        [input, output, process] = popen2(executable, {'-P', '-m', 'crtk_drivers.client.matlab.server'});
    end
    fputs(input, [request "\n"]);
    fflush(input);
    answer = '';
    start = tic;
    while isempty(answer) || answer(end) ~= "\n"
        piece = fgets(output);
        if ischar(piece)
            answer = [answer piece];
            continue
        end
        if toc(start) > 30.0 || waitpid(process, WNOHANG()) == process
            process = [];
            error('crtk:ConnectionLost', ['the process that runs the client (%s) has ended, or ' ...
                'does not answer. Make crtk.ral and crtk.utils anew.'], executable);
        end
        fclear(output);
        pause(0.0005);
    end
end
